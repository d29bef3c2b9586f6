"""Adding one row: new, there already and equal, or refused."""

import sqlite3
from collections.abc import Iterable
from json import dumps

from pipeline.errors import StoreError
from pipeline.store.folder import ELSEWHERE
from schemas.base import Frozen

type Cell = str | int | float | None


def require(db: sqlite3.Connection, table: str, id: str, where: str) -> None:
    """A row may only speak of rows that are there.

    Raises:
        StoreError: this one is not.
    """
    if db.execute(f"SELECT 1 FROM {table} WHERE id = ?", (id,)).fetchone() is None:
        raise StoreError(
            f"{table} {id} is not in the store", where=where, mend=f"add the {table} first, or in the same commit"
        )


def require_all(db: sqlite3.Connection, table: str, ids: Iterable[str], where: str) -> None:
    """The same for many rows in one question: a version may have 100,000 episodes.

    Raises:
        StoreError: one is not there; names the first.
    """
    missing = db.execute(f"SELECT value FROM json_each(?) WHERE value NOT IN (SELECT id FROM {table}) ORDER BY key"
                         " LIMIT 1", (dumps(list(ids)),)).fetchone()
    if missing is not None:
        require(db, table, missing[0], where)


def insert(db: sqlite3.Connection, table: str, value: Frozen, key: tuple[str, ...], row: dict[str, Cell]) -> None:
    """Add a value as JSON with the columns that queries filter by; an equal one that is there is left alone.

    Raises:
        StoreError: a different one is there under this key.
    """
    text = value.model_dump_json()
    columns, marks = ", ".join(row), ", ".join("?" * (len(row) + 1))
    added = db.execute(
        f"INSERT INTO {table} ({columns}, json) VALUES ({marks}) ON CONFLICT DO NOTHING", (*row.values(), text)
    ).rowcount
    if added:
        return
    match = " AND ".join(f"{k} = ?" for k in key)
    (old,) = db.execute(f"SELECT json FROM {table} WHERE {match}", tuple(row[k] for k in key)).fetchone()
    if old != text:
        _refuse_change(f"{table} {' '.join(str(row[k]) for k in key)}", type(value).model_validate_json(old), value)


def _refuse_change(name: str, old: Frozen, new: Frozen) -> None:
    fields = [field for field in type(new).model_fields if getattr(old, field) != getattr(new, field)]
    if fields:  # none: only the spelling differs, such as a field that a later schema gave a default
        raise StoreError(
            f"{name} is in the store with another {', '.join(fields)}",
            where=name,
            mend="what is stored never changes; code or inputs changed under one id: use another folder"
            f" ({ELSEWHERE}) or take the change back",
        )
