"""Erasures in the catalog: ordered, carried out in one commit, finished; and what is known of them afterwards."""

import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from json import dumps

from pipeline.errors import StoreError
from pipeline.store.catalog import Catalog
from schemas.dataset import DatasetVersion
from schemas.episode import Episode
from schemas.erasure import Erasure
from schemas.hardcase import HardCase

IDS = "(SELECT value FROM json_each(?))"


def order(db: sqlite3.Connection, erasure: Erasure) -> None:
    """Write down what will go, and keep it from coming back; from now on the erasure must be finished."""
    db.execute("INSERT INTO erasure (id, state, json) VALUES (?, 'begun', ?)",
               (erasure.id, erasure.model_dump_json()))
    gone = {"episode": erasure.episodes, "hard_case": erasure.hard_cases, "raw_log": erasure.raw_logs,
            "conversion": erasure.conversions, "blob": (*erasure.blobs, *erasure.shards)}
    for kind, ids in gone.items():
        db.executemany("INSERT OR IGNORE INTO erased VALUES (?, ?, ?)", [(id, kind, erasure.id) for id in ids])
    db.execute("INSERT OR IGNORE INTO erased_version SELECT version, episode FROM version_episode"
               f" WHERE episode IN {IDS}", (dumps(erasure.episodes),))


def strike(db: sqlite3.Connection, erasure: Erasure, shards: Mapping[str, str],
           versions: Sequence[DatasetVersion]) -> None:
    """Take the rows away, and let those that stay speak of the files as they are now.

    Args:
        db: within a commit.
        erasure: what goes.
        shards: hash of each shard as it was -> as it is without the erased variants.
        versions: the versions that held an erased episode, as they are now.
    """
    gone = dumps(erasure.episodes)
    for old, new in shards.items():
        kept = db.execute(f"SELECT json FROM episode WHERE blob = ? AND id NOT IN {IDS}", (old, gone)).fetchall()
        moved = [Episode.model_validate_json(text).model_copy(update={"blob": new}) for (text,) in kept]
        db.executemany("UPDATE episode SET blob = ?, json = ? WHERE id = ?",
                       [(new, e.model_dump_json(), e.id) for e in moved])
        db.execute("INSERT OR IGNORE INTO version_input SELECT version, ? FROM version_input WHERE blob = ?",
                   (new, old))
    blobs, digests = (*erasure.blobs, *erasure.shards), [_digest(db, v.id) for v in versions]
    for table, column, values in (
            ("version_input", "blob", blobs), ("version_episode", "episode", erasure.episodes),
            ("hard_case", "id", erasure.hard_cases), ("checked", "subject", (*blobs, *digests))):
        db.execute(f"DELETE FROM {table} WHERE {column} IN {IDS}", (dumps(values),))
    _uncorrected(db, gone)
    db.execute(f"DELETE FROM episode WHERE id IN {IDS}", (gone,))
    for table, column, values in (("ingestion", "conversion", erasure.conversions),
                                  ("conversion", "id", erasure.conversions), ("raw_log", "id", erasure.raw_logs)):
        db.execute(f"DELETE FROM {table} WHERE {column} IN {IDS}", (dumps(values),))
    db.executemany("UPDATE version SET json = ? WHERE id = ?", [(v.model_dump_json(), v.id) for v in versions])


def finish(db: sqlite3.Connection, erasure: Erasure) -> None:
    """Note that nothing is left to do."""
    db.execute("UPDATE erasure SET state = 'done' WHERE id = ?", (erasure.id,))


def unfinished(catalog: Catalog) -> list[Erasure]:
    """Erasures that were ordered and cut off."""
    rows = catalog.rows("SELECT json FROM erasure WHERE state <> 'done' ORDER BY place")
    return [Erasure.model_validate_json(str(text)) for (text,) in rows]


def erased(catalog: Catalog, ids: Iterable[str]) -> dict[str, Erasure]:
    """Those of some ids or hashes that were forgotten -> the erasure."""
    rows = catalog.rows("SELECT erased.id, json FROM erased JOIN erasure ON erasure.id = erasure"
                        f" WHERE erased.id IN {IDS}", (dumps(list(ids)),))
    told = {text: Erasure.model_validate_json(str(text)) for text in {str(text) for _, text in rows}}
    return {str(id): told[str(text)] for id, text in rows}


def erased_in(catalog: Catalog, version: str) -> dict[str, Erasure]:
    """Episodes that a dataset version held and that were forgotten -> the erasure."""
    return erased(catalog, [str(e) for (e,) in catalog.rows(
        "SELECT episode FROM erased_version WHERE version = ? ORDER BY episode", (version,))])


def forgotten(id: str, kind: str, erasure: Erasure) -> StoreError:
    """The error for what was forgotten, wherever it is asked for or comes again."""
    return StoreError(f"{kind} {id} was forgotten on {erasure.at.date()}: {erasure.reason}",
                      where=f"erasure {erasure.id}",
                      mend=f"leave it out; see what went with it: hardcase why {erasure.episode}")


def refuse_forgotten(db: sqlite3.Connection, kind: str, ids: Iterable[str]) -> None:
    """Raise StoreError if something that is to be added was forgotten before, or is being forgotten now."""
    row = db.execute("SELECT erased.id, json FROM erased JOIN erasure ON erasure.id = erasure"
                     f" WHERE erased.id IN {IDS} LIMIT 1", (dumps(list(ids)),)).fetchone()
    if row is not None:
        raise forgotten(row[0], kind, Erasure.model_validate_json(row[1]))


def refuse_unfinished(catalog: Catalog) -> None:
    """Raise StoreError while an erasure is to be finished: half of a thing may still be there."""
    if left := unfinished(catalog):
        raise StoreError(f"forgetting episode {left[0].episode} was cut off", where=catalog.path.parent,
                         mend=f"finish it: hardcase forget {left[0].episode} --yes")


def _digest(db: sqlite3.Connection, version: str) -> str:
    (text,) = db.execute("SELECT json_extract(json, '$.digest') FROM version WHERE id = ?", (version,)).fetchone()
    return str(text)


def _uncorrected(db: sqlite3.Connection, gone: str) -> None:
    """Hard cases whose correction goes stand as they were before it."""
    rows = db.execute(f"SELECT json FROM hard_case WHERE correction IN {IDS}", (gone,)).fetchall()
    cases = [HardCase.model_validate_json(text).model_copy(update={"correction": None, "corrected": False})
             for (text,) in rows]
    db.executemany("UPDATE hard_case SET correction = NULL, corrected = 0, json = ? WHERE id = ?",
                   [(c.model_dump_json(), c.id) for c in cases])
