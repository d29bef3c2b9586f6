"""Applying an ingest map to decoded messages: which numbers, in which order, in which unit."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.documents import load_document
from pipeline.logs.fields import Fields
from schemas.ingest import IngestMap, Source, Unit, Value

EXAMPLE = "docs/ingest.md shows a whole map; a first one for a log: hardcase ingest --suggest LOG"

UNITS: MappingProxyType[Unit, float] = MappingProxyType({
    "deg_to_rad": np.pi / 180, "rad_to_deg": 180 / np.pi, "mm_to_m": 1e-3, "cm_to_m": 1e-2, "ms_to_s": 1e-3,
})
"""Conversion -> factor."""

_PATH = re.compile(r"([^\[]+)(?:\[(\d+)(?::(\d+))?\])?")

type Rows = NDArray[np.float64]
type Places = NDArray[np.intp]


def load_map(file: Path) -> IngestMap:
    """Read a map that somebody declared.

    Raises:
        ConfigError: no such file, not YAML, or a value that breaks a rule: field, value and rule in one line.
    """
    return load_document(file, IngestMap, kind="an ingest map", example=EXAMPLE)


class Taker:
    """Takes the values of one source out of batches; what does not fit is counted, never filled in."""

    def __init__(self, source: Source) -> None:
        self.refused: Counter[str] = Counter()
        """Reason -> messages that were not used for it."""
        self.seen: set[str] = set()
        """Number fields that messages had, where the ones asked for were missing."""
        self._source = source
        self._paths = [_parsed(path) for path in source.fields]
        self._widths: dict[str, int] = {}
        self._orders: dict[tuple[str, ...], Places | None] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values, once a message was taken."""
        source = self._source
        if source.names:
            return source.names
        if source.joints:
            several = len(source.fields) > 1
            return tuple(f"{joint}.{path}" if several else joint for path in source.fields for joint in source.joints)
        return tuple(name for path, (column, first, _) in zip(source.fields, self._paths, strict=True)
                     for name in _element_names(column, first, self._widths[path]))

    def take(self, fields: Fields) -> tuple[Places, Rows]:
        """Messages that have all that is asked for, shape (m,), and their values as they are, shape (m, width)."""
        found = [self._column(fields, path, *parsed)
                 for path, parsed in zip(self._source.fields, self._paths, strict=True)]
        kept = found[0][0]
        for rows, _ in found[1:]:
            kept = np.intersect1d(kept, rows, assume_unique=True)
        parts = [values if rows.size == kept.size else values[np.searchsorted(rows, kept)] for rows, values in found]
        return kept, np.concatenate(parts, axis=1) if kept.size else np.zeros((0, 0))

    def in_unit(self, values: Rows) -> Rows:
        """Values in the declared unit, scaled and offset."""
        source = self._source
        if source.unit is not None:
            values = values * UNITS[source.unit]
        if source.scale != 1.0:
            values = values * np.asarray(source.scale)
        return values + np.asarray(source.offset) if source.offset != 0.0 else values

    def _column(self, fields: Fields, path: str, column: str, first: int, stop: int | None) -> tuple[Places, Rows]:
        everything = np.arange(len(fields))
        if (values := fields.values.get(column)) is not None:
            whole = values[:, None] if values.ndim == 1 else values
            if self._source.joints:
                return self._by_name(fields, path, whole)
            return self._elements(path, everything, whole, first, stop)
        if (ragged := fields.ragged.get(column)) is not None:
            if self._source.joints:
                return self._by_name(fields, path, ragged)
            return self._by_length(path, ragged, first, stop)
        self.seen |= {*fields.values, *fields.ragged}
        self._refuse(f"no number field {column!r}", len(fields))
        return self._none(path)

    def _elements(self, path: str, rows: Places, whole: NDArray[Any], first: int, stop: int | None,
                  ) -> tuple[Places, Rows]:
        length = whole.shape[1]
        if stop is None:  # the whole array: the first message that has one says how long it is
            wanted = self._widths.get(path, length)
            fits = length == wanted > 0
        else:
            wanted, fits = stop, length >= stop
        if not fits:
            self._refuse(f"{path} has {length} values, {wanted or 'some'} were expected", rows.size)
            return self._none(path)
        self._widths[path] = wanted - first
        return rows, whole[:, first:wanted].astype(np.float64)

    def _by_length(self, path: str, ragged: Sequence[NDArray[Any]], first: int, stop: int | None,
                   ) -> tuple[Places, Rows]:
        lengths = np.array([len(row) for row in ragged])
        found: list[tuple[Places, Rows]] = []
        for length in sorted(set(lengths.tolist()), key=lambda n: int(np.argmax(lengths == n))):
            rows = np.flatnonzero(lengths == length)
            found.append(self._elements(path, rows, _stacked(ragged, rows), first, stop))
        return _joined(found, self._widths.get(path, 0))

    def _by_name(self, fields: Fields, path: str, columns: NDArray[Any] | Sequence[NDArray[Any]],
                 ) -> tuple[Places, Rows]:
        named = fields.names.get(self._source.joints_field)
        self._widths[path] = len(self._source.joints)
        if named is None:
            self._refuse(f"no field {self._source.joints_field!r} of names", len(fields))
            return self._none(path)
        groups: dict[tuple[str, ...], list[int]] = {}
        for k, names in enumerate(named):
            groups.setdefault(names, []).append(k)
        found: list[tuple[Places, Rows]] = []
        for names, members in groups.items():
            rows = np.array(members)
            if (order := self._order(names, rows.size)) is None:
                continue
            fits = np.array([len(columns[k]) == len(names) for k in members])
            if not fits.all():
                self._refuse(f"{path} has not one value for each name", int((~fits).sum()))
            rows = rows[fits]
            if rows.size:
                whole = columns[rows] if isinstance(columns, np.ndarray) else _stacked(columns, rows)
                found.append((rows, whole[:, order].astype(np.float64)))
        return _joined(found, self._widths[path])

    def _order(self, names: tuple[str, ...], messages: int) -> Places | None:
        """Where the declared joints stand among a message's names; None where one is missing."""
        if names not in self._orders:
            missing = [joint for joint in self._source.joints if joint not in names]
            self._orders[names] = None if missing else np.array([names.index(j) for j in self._source.joints])
        if self._orders[names] is None:
            missing = next(joint for joint in self._source.joints if joint not in names)
            self._refuse(f"does not name joint {missing!r}", messages)
        return self._orders[names]

    def _refuse(self, reason: str, messages: int) -> None:
        if messages:
            self.refused[reason] += messages

    def _none(self, path: str) -> tuple[Places, Rows]:
        return np.zeros(0, np.intp), np.zeros((0, self._widths.get(path, 0)))


def said(fields: Fields, path: str) -> list[tuple[int, Value]]:
    """(message, value) of a field that holds one number, truth value or text a message."""
    column, first, stop = _parsed(path)
    if (texts := fields.texts.get(column)) is not None:
        return list(enumerate(texts))
    values = fields.values.get(column)
    if values is None:
        return []
    if values.ndim == 2:
        if stop is None or first >= values.shape[1]:
            return []
        values = values[:, first]
    numbers: list[int | float | bool] = values.tolist()
    return [*enumerate(numbers)]


def _parsed(path: str) -> tuple[str, int, int | None]:
    """Column, first element and the one after the last; None where all elements are meant."""
    match = _PATH.fullmatch(path)
    assert match, "the schema lets no other path through"
    column, first, stop = match.groups()
    if first is None:
        return column, 0, None
    return column, int(first), int(stop) if stop else int(first) + 1


def _stacked(columns: Sequence[NDArray[Any]], rows: Places) -> NDArray[Any]:
    """Arrays of one length, below each other."""
    chosen: list[NDArray[Any]] = [columns[k] for k in rows.tolist()]
    return np.stack(chosen)


def _element_names(column: str, first: int, width: int) -> list[str]:
    return [column] if width == 1 else [f"{column}_{k}" for k in range(first, first + width)]


def _joined(found: list[tuple[Places, Rows]], width: int) -> tuple[Places, Rows]:
    if not found:
        return np.zeros(0, np.intp), np.zeros((0, width))
    rows = np.concatenate([rows for rows, _ in found])
    order = np.argsort(rows, kind="stable")
    return rows[order], np.concatenate([values.reshape(-1, width) for _, values in found])[order]
