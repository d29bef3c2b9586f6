"""The columns of ROS 2 messages that are laid out alike."""

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.logs.columns import Columns, Rows
from pipeline.logs.fields import Numbers
from pipeline.logs.ros2_layout import SLACK, Kind, Layout, Leaf, Walk

if TYPE_CHECKING:
    from pipeline.logs.batch import Batch

_NS = 1_000_000_000

type Texts = dict[int, list[tuple[str, ...]]]
"""Leaf -> its texts in each message."""


class Block:
    """Messages of a batch that share a layout; only what is asked for is gathered."""

    def __init__(self, layout: Layout, batch: "Batch", rows: Rows) -> None:
        self.layout, self.batch, self.rows = layout, batch, rows
        self._head = self._gather(0, len(layout.head))

    def _gather(self, low: int, high: int) -> NDArray[np.uint8]:
        if high <= low or not self.rows.size:
            return np.zeros((self.rows.size, max(high - low, 0)), np.uint8)
        windows = np.lib.stride_tricks.sliding_window_view(np.frombuffer(self.batch.data, np.uint8), high - low)
        return windows[self.batch.starts[self.rows] + low]

    def span(self, low: int, high: int) -> NDArray[np.uint8]:
        """Bytes [low, high) of every message, shape (m, high - low)."""
        return self._head[:, low:high] if high <= self._head.shape[1] else self._gather(low, high)

    def keep(self, mask: NDArray[np.bool_]) -> "Block":
        """The block of those messages only."""
        return self if mask.all() else Block(self.layout, self.batch, self.rows[mask])

    def alike(self) -> NDArray[np.bool_]:
        """Which messages have the layout's byte order and counts."""
        layout, sizes = self.layout, self.batch.sizes[self.rows]
        expected = np.frombuffer(layout.head, np.uint8)[layout.signs]
        fits = (self._head[:, layout.signs] == expected).all(axis=1)
        for at, count in layout.lengths:
            if at >= len(layout.head):
                fits &= (self.span(at, at + 4) == np.frombuffer(count, np.uint8)).all(axis=1)
        if layout.tail >= 0:
            at, _ = layout.runs[layout.tail][0]
            end = at + self._tail_sizes()
            fits &= (end <= sizes) & (sizes <= end + SLACK)
        return fits

    def _tail_sizes(self) -> NDArray[np.int64]:
        at, _ = self.layout.runs[self.layout.tail][0]
        order = ">u4" if self.layout.big else "<u4"
        return np.ascontiguousarray(self.span(at - 4, at)).view(order)[:, 0].astype(np.int64)

    def texts(self) -> tuple[Texts, list[tuple[int, str]]]:
        """The texts of every message, and (place in the block, reason) of those whose texts cannot be read."""
        layout = self.layout
        same = bool((self._head[:, layout.letters] == np.frombuffer(layout.head, np.uint8)[layout.letters]).all())
        found: Texts = {}
        wrong: dict[int, str] = {}
        for k, (leaf, runs) in enumerate(zip(layout.plan.leaves, layout.runs, strict=True)):
            if leaf.kind not in ("text", "wide"):
                continue
            once = same and k != layout.tail and all(at + size <= len(layout.head) for at, size in runs)
            count = min(1, self.rows.size) if once else self.rows.size
            lines: list[tuple[str, ...]] = []
            for row, pieces in enumerate(self._pieces(k, runs, count)):
                try:
                    lines.append(tuple([_text(self.layout, leaf.kind, piece) for piece in pieces]))
                except ValueError as error:
                    lines.append(("",) * len(runs))
                    wrong.update(dict.fromkeys(range(self.rows.size) if once else (row,), f"{leaf.path}: {error}"))
            found[k] = lines * self.rows.size if once else lines
        return found, sorted(wrong.items())

    def _pieces(self, leaf: int, runs: Sequence[tuple[int, int]], count: int) -> Iterable[tuple[bytes, ...]]:
        """The bytes of the texts of one leaf in each of the first `count` messages."""
        if leaf == self.layout.tail:
            return [(bytes(piece),) for piece in self._views(leaf)]
        columns = [[piece.tobytes() for piece in self.span(at, at + size)[:count]] for at, size in runs]
        return zip(*columns, strict=True) if columns else [()] * count

    def _views(self, leaf: int) -> list[memoryview]:
        """The bytes of a leaf in each message, its runs joined."""
        data, starts = memoryview(self.batch.data), self.batch.starts[self.rows].tolist()
        runs = self.layout.runs[leaf]
        if leaf == self.layout.tail:
            at = runs[0][0]
            return [data[s + at : s + at + size] for s, size in zip(starts, self._tail_sizes().tolist(), strict=True)]
        if len(runs) == 1:
            at, size = runs[0]
            return [data[s + at : s + at + size] for s in starts]
        return [memoryview(b"".join(data[s + at : s + at + size] for at, size in runs)) for s in starts]

    def _numbers(self, leaf: Leaf, runs: Sequence[tuple[int, int]]) -> Numbers:
        """The numbers of a leaf, shape (m,) or (m, k), in the machine's byte order."""
        runs = [run for run in runs if run[1]]
        if not runs:
            data = np.zeros((self.rows.size, 0), np.uint8)
        elif len(runs) == 1:
            data = self.span(runs[0][0], sum(runs[0]))
        else:
            low, high = runs[0][0], sum(runs[-1])
            places = np.concatenate([np.arange(at - low, at - low + size) for at, size in runs])
            data = self.span(low, high)[:, places]
        column = _column(leaf, data, big=self.layout.big)
        return column if leaf.many else np.ascontiguousarray(column[:, 0])

    def columns(self, texts: Texts) -> Columns:
        """All columns; `texts` are those of this block."""
        columns = Columns(times=self.layout.plan.times)
        for k, (leaf, runs) in enumerate(zip(self.layout.plan.leaves, self.layout.runs, strict=True)):
            if leaf.kind in ("text", "wide"):
                if leaf.many:
                    columns.names[leaf.path] = texts[k]
                else:
                    columns.texts[leaf.path] = [line[0] for line in texts[k]]
            elif leaf.kind == "blob":
                columns.blobs[leaf.path] = self._views(k)
            elif leaf.kind != "skip":
                columns.values[leaf.path] = self._numbers(leaf, runs)
        return columns


def _column(leaf: Leaf, data: NDArray[np.uint8], *, big: bool) -> Numbers:
    """The bytes of a leaf, shape (m, size), as numbers in the machine's byte order, shape (m, k)."""
    if leaf.dtype == "?":
        return data != 0
    order, dtype = ">" if big else "<", "u4" if leaf.kind == "time" else leaf.dtype
    column = np.ascontiguousarray(data).reshape(-1).view(order + dtype)
    column = column.astype(column.dtype.newbyteorder("="), copy=False).reshape(len(data), -1 if data.size else 0)
    if leaf.kind != "time":
        return column
    return column[:, 0::2].view(np.int32).astype(np.int64) * _NS + column[:, 1::2]


def _text(layout: Layout | Walk, kind: Kind, data: bytes) -> str:
    if kind == "wide":
        return data.decode(f"utf-{8 * layout.wide}-{'be' if layout.big else 'le'}")
    if data and data[-1]:
        raise ValueError("a text has no closing zero byte")
    return data[:-1].decode()


def each(batch: "Batch", found: Sequence[tuple[int, Walk]], bad: list[tuple[int, str]]) -> tuple[Rows, Columns]:
    """Columns of messages that are laid out each in its own way, read one by one; all of one byte order."""
    plan, big = found[0][1].plan, found[0][1].big
    wordy = [k for k, leaf in enumerate(plan.leaves) if leaf.kind in ("text", "wide")]
    good: list[tuple[memoryview, Walk]] = []
    rows: list[int] = []
    texts: list[list[tuple[str, ...]]] = []
    for row, walk in found:
        data = batch.payload(row)
        try:
            texts.append([tuple([_text(walk, plan.leaves[k].kind, bytes(data[at : at + size]))
                                 for at, size in walk.runs[k]]) for k in wordy])
        except ValueError as error:
            bad.append((row, str(error)))
            continue
        rows.append(row)
        good.append((data, walk))
    columns = Columns(times=plan.times)
    for place, k in enumerate(wordy):
        if plan.leaves[k].many:
            columns.names[plan.leaves[k].path] = [lines[place] for lines in texts]
        else:
            columns.texts[plan.leaves[k].path] = [lines[place][0] for lines in texts]
    for k, leaf in enumerate(plan.leaves):
        if leaf.kind in ("blob", "number", "time"):
            _join(columns, leaf, [[data[at : at + size] for at, size in walk.runs[k]] for data, walk in good], big=big)
    return np.array(rows, np.intp), columns


def _join(columns: Columns, leaf: Leaf, pieces: Sequence[Sequence[memoryview]], *, big: bool) -> None:
    """Add the column of one leaf, whose bytes are given in pieces for each message."""
    if leaf.kind == "blob":
        columns.blobs[leaf.path] = [p[0] if len(p) == 1 else memoryview(b"".join(p)) for p in pieces]
        return
    flat = _column(leaf, np.frombuffer(b"".join(chain.from_iterable(pieces)), np.uint8)[None], big=big)[0]
    if leaf.many:
        columns.split(leaf.path, flat, [sum(map(len, p)) // leaf.size for p in pieces])
    else:
        columns.values[leaf.path] = flat
