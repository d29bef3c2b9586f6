"""Columns while they are made: parts of a batch put together, and what lies below sequences laid end to end."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, chain, pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.logs.fields import STAMPS, Fields, Numbers

type Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Columns:
    """The columns of n messages, or of n elements of a sequence; see Fields for each."""

    values: dict[str, Numbers] = field(default_factory=dict[str, Numbers])
    ragged: dict[str, list[Numbers]] = field(default_factory=dict[str, list[Numbers]])
    texts: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    names: dict[str, list[tuple[str, ...]]] = field(default_factory=dict[str, list[tuple[str, ...]]])
    blobs: dict[str, list[memoryview]] = field(default_factory=dict[str, list[memoryview]])
    times: set[str] = field(default_factory=set[str])
    """Paths of times [ns]."""

    def sequences(self, path: str, rows: Sequence[Numbers]) -> None:
        """Add one sequence of numbers a message: `values` where all are as long, else `ragged`."""
        if len({len(row) for row in rows}) == 1:
            self.values[path] = np.stack(rows)
        elif rows:
            self.ragged[path] = list(rows)

    def split(self, path: str, flat: Numbers, counts: Sequence[int]) -> None:
        """Add sequences of numbers that lie end to end, `counts` of them in each message."""
        if len(set(counts)) == 1:
            self.values[path] = flat.reshape(len(counts), counts[0])
        elif counts:
            self.ragged[path] = np.split(flat, list(accumulate(counts))[:-1])

    def nest(self, inner: "Columns", counts: Sequence[int], prefix: str = "") -> None:
        """Add the columns of elements, `counts` of them in each message, each message's laid end to end."""
        bounds = list(pairwise((0, *accumulate(counts))))
        self.times.update(prefix + path for path in inner.times)
        for path, column in inner.values.items():
            width = column.shape[1] if column.ndim == 2 else 1
            self.split(prefix + path, column.reshape(-1), [count * width for count in counts])
        for path, arrays in inner.ragged.items():
            self.sequences(prefix + path, [np.concatenate([arrays[0][:0], *arrays[a:b]]) for a, b in bounds])
        for path, texts in inner.texts.items():
            self.names[prefix + path] = [tuple(texts[a:b]) for a, b in bounds]
        for path, names in inner.names.items():
            self.names[prefix + path] = [tuple(chain.from_iterable(names[a:b])) for a, b in bounds]
        for path, blobs in inner.blobs.items():
            self.blobs[prefix + path] = [memoryview(b"".join(blobs[a:b])) for a, b in bounds]

    def fields(self, rows: Rows, bad: Iterable[tuple[int, str]]) -> Fields:
        """The columns as what a batch says; `rows` and `bad` as in Fields."""
        stamp = next((self.values[path] for path in STAMPS if path in self.times and path in self.values), None)
        header = stamp if stamp is not None and stamp.ndim == 1 else None
        return Fields(rows, tuple(sorted(bad)), self.values, self.ragged, self.texts, self.names, self.blobs, header,
                      frozenset(self.times))

    def keep(self, mask: NDArray[np.bool_]) -> "Columns":
        """The columns of some messages only."""
        if mask.all():
            return self
        kept: list[int] = np.flatnonzero(mask).tolist()
        left = Columns(times=self.times)
        left.values.update({path: column[mask] for path, column in self.values.items()})
        for path, arrays in self.ragged.items():
            left.sequences(path, [arrays[k] for k in kept])
        _pick(left.texts, self.texts, kept)
        _pick(left.names, self.names, kept)
        _pick(left.blobs, self.blobs, kept)
        return left


def _pick[T](into: dict[str, list[T]], columns: dict[str, list[T]], places: Sequence[int]) -> None:
    for path, column in columns.items():
        into[path] = [column[k] for k in places]


def merge(parts: Sequence[tuple[Rows, Columns]]) -> tuple[Rows, Columns]:
    """Parts of one batch, which have the same paths, as one: its messages in order again."""
    if not parts:
        return np.zeros(0, np.intp), Columns()
    if len(parts) == 1:
        return parts[0]
    rows = np.concatenate([rows for rows, _ in parts])
    order = np.argsort(rows)
    all_columns = [columns for _, columns in parts]
    places: list[int] = order.tolist()
    first, merged = all_columns[0], Columns(times=all_columns[0].times)
    for path in (*first.values, *first.ragged):
        pieces = [columns.values.get(path) for columns in all_columns]
        whole = [piece for piece in pieces if piece is not None]
        if len(whole) == len(pieces) and len({piece.shape[1:] for piece in whole}) == 1:
            merged.values[path] = np.concatenate(whole)[order]
        else:
            flat: list[Numbers] = [row for columns in all_columns for row in _rows(columns, path)]
            merged.sequences(path, [flat[k] for k in places])
    _pick(merged.texts, _joined([columns.texts for columns in all_columns]), places)
    _pick(merged.names, _joined([columns.names for columns in all_columns]), places)
    _pick(merged.blobs, _joined([columns.blobs for columns in all_columns]), places)
    return rows[order], merged


def _joined[T](parts: Sequence[dict[str, list[T]]]) -> dict[str, list[T]]:
    return {path: [cell for part in parts for cell in part[path]] for path in parts[0]}


def _rows(columns: Columns, path: str) -> Iterable[Numbers]:
    return columns.values[path] if path in columns.values else columns.ragged[path]
