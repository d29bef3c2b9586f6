"""Spools: samples of one topic, put down on the disk as they come and read again in the order of their stamps.

A log is read once and may be far larger than memory; of a spool one number in 65,536 stays in memory.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

BLOCK = 1 << 16
"""Samples from one stamp that stays in memory to the next."""
AT_ONCE = 4096
"""Samples that wait in memory before they are sorted out and written."""
GATHER = 1 << 20
"""Most numbers that are read at once to pick a few of them."""
LATCHED_NS = 3_600_000_000_000
"""A stamp of 0 says nothing when everything else comes more than an hour later."""

type Stamps = NDArray[np.int64]
type Places = NDArray[np.int64]
type Rows = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Back:
    """Where stamps went back the farthest."""

    message: int
    """How many samples came before."""
    by_ns: int
    """How far behind the latest stamp until then [ns]; 0 where stamps never went back."""


class Spool:
    """Takes the samples of one topic in file order. Of several with one stamp the last counts."""

    def __init__(self, file: Path, width: int) -> None:
        self.width, self.count, self.zeros, self.repeated, self.back = width, 0, 0, 0, Back(0, 0)
        self._file, self._latest, self._waiting_for = file, -(1 << 62), 0
        self._waiting: list[tuple[Stamps, Rows]] = []
        self._zero = self._held = np.zeros(0, np.int64), np.zeros((0, width))
        self._stamps, self._values = _part(file, "t").open("wb"), _part(file, "v").open("wb")
        self._write(np.zeros(1, np.int64), np.zeros((1, width)))  # a place for the sample at 0

    def append(self, stamps: Stamps, values: Rows) -> None:
        """Take samples, shapes (n,) [ns] and (n, width)."""
        if not stamps.size:
            return
        self._waiting.append((stamps, values))
        self._waiting_for += stamps.size
        if self._waiting_for >= AT_ONCE:
            self._flush()

    def finish(self) -> "Samples":
        """Everything that came, in the order of the stamps."""
        self._flush()
        self._write(*self._held)
        self._stamps.close()
        self._values.close()
        if self.back.by_ns > 0:
            self._sort()
        first = np.fromfile(_part(self._file, "t"), np.int64, 1, offset=8)
        latched = self.zeros == 0 or first.size == 0 or first[0] > LATCHED_NS
        if not latched:
            with _part(self._file, "v").open("r+b") as values:
                values.write(np.ascontiguousarray(self._zero[1]).data)
        return Samples(self._file, self.width, int(latched), dropped=self.zeros if latched else 0)

    def _flush(self) -> None:
        if not self._waiting:
            return
        stamps = np.concatenate([s for s, _ in self._waiting])
        values = np.concatenate([v for _, v in self._waiting])
        self._waiting, self._waiting_for = [], 0
        zero = stamps == 0
        if zero.any():
            self._zero = stamps[zero][-1:], values[zero][-1:]
            self.zeros += int(zero.sum())
        self._note_order(stamps, zero)
        self.count += stamps.size
        stamps, values = np.append(self._held[0], stamps[~zero]), np.concatenate([self._held[1], values[~zero]])
        if stamps.size:
            last = np.append(stamps[1:] != stamps[:-1], False)
            self.repeated += stamps.size - 1 - int(last.sum())
            self._write(stamps[last], values[last])
            self._held = stamps[-1:], values[-1:]

    def _note_order(self, stamps: Stamps, zero: NDArray[np.bool_]) -> None:
        latest = np.maximum.accumulate(np.append(self._latest, stamps))
        behind = np.where(zero, 0, latest[:-1] - stamps)
        worst = int(behind.argmax())
        if behind[worst] > self.back.by_ns:
            self.back = Back(self.count + worst, int(behind[worst]))
        self._latest = int(latest[-1])

    def _write(self, stamps: Stamps, values: Rows) -> None:
        self._stamps.write(np.ascontiguousarray(stamps).data)
        self._values.write(np.ascontiguousarray(values).data)

    def _sort(self) -> None:
        """Bring the files into order; only here all stamps of a topic are in memory at once."""
        stamps = np.fromfile(_part(self._file, "t"), np.int64)[1:]
        order = np.argsort(stamps, kind="stable")
        ordered = stamps[order]
        kept = order[np.append(ordered[1:] != ordered[:-1], True)]
        self.repeated += stamps.size - kept.size
        unsorted = Samples(self._file, self.width, 0, dropped=0)
        aside = _part(self._file, "sorted")
        with aside.open("wb") as target:
            target.write(np.zeros((1, self.width)).data)
            for start in range(0, kept.size, BLOCK):
                target.write(np.ascontiguousarray(unsorted.values(kept[start:start + BLOCK] + 1)).data)
        aside.replace(_part(self._file, "v"))
        np.append(np.int64(0), stamps[kept]).tofile(_part(self._file, "t"))


class Samples:
    """The samples of a spool by their place in the order of stamps, from `first` to before `end`."""

    def __init__(self, file: Path, width: int, first: int, *, dropped: int) -> None:
        self.width, self.first, self.dropped, self._file = width, first, dropped, file
        self.end = _part(file, "t").stat().st_size // 8
        at = range(first, self.end, BLOCK)
        self._heads = np.array([self._read_stamps(k, 1)[0] for k in at], np.int64)

    def __len__(self) -> int:
        return self.end - self.first

    @property
    def span(self) -> tuple[int, int]:
        """First and last stamp [ns]; there must be one."""
        return int(self._heads[0]), int(self._read_stamps(self.end - 1, 1)[0])

    def before(self, ticks: Stamps) -> Places:
        """Place of the last sample at or before each tick, first - 1 where there is none; ticks must not fall."""
        places: Places = np.full(ticks.shape, self.first - 1, np.int64)
        if not ticks.size or not len(self):
            return places
        low = max(int(np.searchsorted(self._heads, int(ticks[0]), "right")) - 1, 0)
        high = int(np.searchsorted(self._heads, int(ticks[-1]), "right"))
        places += low * BLOCK
        for block in range(low, high):
            places += self._read_stamps(self.first + block * BLOCK, BLOCK).searchsorted(ticks, "right")
        return places

    def next_from(self, time_ns: int) -> int | None:
        """The first stamp at or after a time [ns]."""
        place = int(self.before(np.array([time_ns - 1], np.int64))[0]) + 1
        return int(self._read_stamps(place, 1)[0]) if place < self.end else None

    def runs(self, gap_ns: int) -> NDArray[np.int64]:
        """First and last stamp of every run without a gap longer than `gap_ns`, shape (runs, 2)."""
        edges: list[Stamps] = []
        previous = np.zeros(0, np.int64)
        for place in range(self.first, self.end, BLOCK):
            stamps = self._read_stamps(place, BLOCK)
            joined = np.append(previous, stamps)
            cut = np.flatnonzero(np.diff(joined) > gap_ns)
            edges.append(np.stack([joined[cut], joined[cut + 1]], axis=1).reshape(-1))
            previous = stamps[-1:]
        if not len(self):
            return np.zeros((0, 2), np.int64)
        first, last = self.span
        return np.concatenate([np.array([first], np.int64), *edges, np.array([last], np.int64)]).reshape(-1, 2)

    def stamps(self, places: Places) -> Stamps:
        """Stamps at places that do not fall, shape (n,)."""
        return self._gather(places, 1, "t", np.int64)[:, 0]

    def values(self, places: Places) -> Rows:
        """Values at places in any order, shape (n, width)."""
        return self._gather(places, self.width, "v", np.float64)

    def _read_stamps(self, place: int, count: int) -> Stamps:
        return np.fromfile(_part(self._file, "t"), np.int64, count, offset=8 * place)

    def _gather[T: np.generic](self, places: Places, width: int, kind: str, dtype: type[T]) -> NDArray[T]:
        if not places.size:
            return np.zeros((0, width), dtype)
        low, high = int(places.min()), int(places.max())
        if (high - low + 1) * width > GATHER and places.size > 1:
            half = places.size // 2
            return np.concatenate([self._gather(part, width, kind, dtype) for part in (places[:half], places[half:])])
        rows = np.fromfile(_part(self._file, kind), dtype, (high - low + 1) * width, offset=low * 8 * width)
        return rows.reshape(-1, width)[places - low]


def _part(file: Path, kind: str) -> Path:
    return file.with_name(f"{file.name}.{kind}")
