"""Filling: the values of frames, a piece at a time, so that an episode may be longer than memory."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline.logs.episodes import Bounds
from pipeline.logs.resample import ticks
from pipeline.logs.tables import Column
from pipeline.logs.tracks import Tracks

PIECE = 1 << 14
"""Frames that are filled at once."""
NAMED = 1000
"""Frames with a value that is no number of which is kept which one it was."""

type Piece = dict[str, Column]
type Good = NDArray[np.bool_]


class Filler:
    """Fills frames of one episode; `bad` says of some frames which value is no number."""

    def __init__(self, tracks: Tracks, bound: Bounds, fps: int, features: Mapping[str, object]) -> None:
        self.bad: dict[int, str] = {}
        self._tracks, self._bound, self._fps, self._features = tracks, bound, fps, features
        self._last: tuple[int, int, Piece, Good] | None = None

    def good(self, first: int, stop: int) -> Good:
        """Which frames from `first` to before `stop` have all of their values."""
        parts = [self._fill(a, min(a + PIECE, stop))[1] for a in range(first, stop, PIECE)]
        return np.concatenate(parts)

    def pieces(self, first: int, stop: int) -> Iterator[Piece]:
        """All columns of good frames from `first` to before `stop`."""
        for a in range(first, stop, PIECE):
            end = min(a + PIECE, stop)
            if self._last is not None and self._last[0] <= a and end <= self._last[1]:  # most episodes are one piece
                from_, _, columns, _ = self._last
                yield {name: rows[a - from_:end - from_] for name, rows in columns.items()}
            else:
                yield self._fill(a, end)[0]

    def _fill(self, first: int, stop: int) -> tuple[Piece, Good]:
        columns, good = self._tracks.blank(stop - first), np.ones(stop - first, np.bool_)
        at = ticks(self._bound.start_ns, first, stop, self._fps)
        for track in self._tracks.all:
            good &= track.fill(at, columns)
        for name in self._features:
            finite = np.isfinite(columns[name])
            if not finite.all():
                self._note(name, columns[name], ~finite & good[:, None], first)
                good &= finite.all(axis=1)
        self._last = first, stop, columns, good
        return columns, good

    def _note(self, name: str, rows: Column, wrong: NDArray[np.bool_], first: int) -> None:
        """Remember the first value of each frame that is no number."""
        for row in np.flatnonzero(wrong.any(axis=1)).tolist():
            if len(self.bad) >= NAMED:
                return
            place = int(wrong[row].argmax())
            value = rows[row, place]
            topic = [t.topic for t in self._tracks.states if t.name == name and t.first <= place][-1]
            told = "NaN" if np.isnan(value) else "Inf" if value > 0 else "-Inf"
            self.bad.setdefault(first + row, f"{name}[{place}] is {told} at frame {first + row}, {topic}")
