"""Framing: episodes laid out on the even clock of a map, out of spooled samples."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.logs.episodes import Bounds, Event, by_gap, by_marker, common, covered, labels, whole
from pipeline.logs.intake import EventIntake
from pipeline.logs.mapping import EXAMPLE
from pipeline.logs.resample import NS, frames_until, ticks
from pipeline.logs.tables import Column, FrameWriter
from pipeline.logs.tracks import SKEW, Tracks
from schemas.conversion import Converted, Skew, Span
from schemas.ingest import Gap, IngestMap, Marker, TopicOutcome

PIECE = 1 << 14
"""Frames that are filled at once."""
MAX_FRAMES = 20_000_000
"""Frames of one episode: 4 days at 50 Hz; more means a clock that is not one."""
TOLD = 20
"""Holes of a log that are told one by one."""


@dataclass(frozen=True, slots=True)
class Run:
    """Frames `first` to before `stop` of an episode, every one with all of its values."""

    first: int
    stop: int
    columns: Mapping[str, Column]


class Framing:
    """Lays out what was taken of one log; `problems` grows with what is missing or left out."""

    def __init__(self, asked: IngestMap, taken: Tracks, events: Sequence[EventIntake], log: Path,
                 problems: list[str]) -> None:
        self._asked, self._tracks, self._log, self._problems = asked, taken, log, problems
        self._events: dict[Marker | TopicOutcome, list[Event]] = {e.wanted: e.events for e in events}
        self._distances: dict[str, list[NDArray[np.float32]]] = {t.name: [] for t in taken.all}
        self._holes = 0

    def write(self, file: Path) -> Converted:
        """Write all episodes and say what they are.

        Raises:
            ConfigError: topics that have no time in common, or an episode without end.
        """
        writer, spans, short = FrameWriter(file), list[Span](), 0
        bounds, outcome = self._bounds(), self._asked.outcome
        told = self._events[outcome] if isinstance(outcome, TopicOutcome) else []
        for number, (bound, label) in enumerate(zip(bounds, labels(bounds, outcome, told), strict=True)):
            for part, run in enumerate(self._runs(number, bound)):
                if run.stop - run.first < self._asked.min_frames:
                    short += 1
                    continue
                writer.append(run.columns)
                for name, found in self._distances.items():
                    found.append(np.abs(run.columns[SKEW + name]).astype(np.float32))
                start = int(ticks(bound.start_ns, run.first, run.first + 1, self._asked.fps)[0])
                spans.append(Span(boundary=number, part=part, start_ns=start, frames=run.stop - run.first, label=label))
        writer.close()
        if short:
            self._problems.append(f"{short} episodes or parts shorter than {self._asked.min_frames} frames left out")
        return Converted(features=dict(self._tracks.features), spans=tuple(spans), skews=self._skews())

    def _bounds(self) -> list[Bounds]:
        everything = [t.samples for t in self._tracks.all]
        rule = self._asked.episodes
        if isinstance(rule, Marker):
            found, odd = by_marker(self._events[rule], rule, max(s.span[1] for s in everything))
            self._problems += odd
            return found
        self._refuse_strangers()
        if isinstance(rule, Gap):
            silent = [t.samples for t in self._tracks.states if rule.topic in (None, t.topic)]
            return by_gap(everything, silent, rule.longer_than_s)
        return whole(everything)

    def _refuse_strangers(self) -> None:
        """Topics on clocks that have nothing to do with each other make no frames."""
        taken = self._tracks.all
        if len(common([covered(t.samples, t.rule, t.max_skew_s) for t in taken])):
            return
        late, early = max(taken, key=lambda t: t.samples.span[0]), min(taken, key=lambda t: t.samples.span[1])
        apart = (late.samples.span[0] - early.samples.span[1]) / NS
        how = f"{late.topic} begins {apart:.3g} s after {early.topic} ends, by {late.clock} and {early.clock} time" \
            if apart > 0 else "no sample of one lies near enough to a sample of each other"
        raise ConfigError(f"the topics have no time in common: {how}", where=self._log,
                             mend=f"declare one clock for all, or a larger max_skew_s; {EXAMPLE}")

    def _runs(self, number: int, bound: Bounds) -> list[Run]:
        """The parts of one episode; what is missing between them is told, or refuses the episode."""
        runs: list[Run] = []
        bad: dict[int, str] = {}
        for first, stop in self._segments(bound):
            columns, good = self._columns(bound, first, stop, bad)
            edges = np.flatnonzero(np.diff(good, prepend=False, append=False)).reshape(-1, 2)
            runs += [Run(first + a, first + b, {name: rows[a:b] for name, rows in columns.items()})
                     for a, b in edges.tolist()]
        self._tell(number, bound, runs, bad)
        if len(runs) > 1 and self._asked.missing == "refuse":
            self._problems.append(f"episode {number} is refused: frames are missing in it")
            return []
        return runs

    def _segments(self, bound: Bounds) -> list[tuple[int, int]]:
        """Frames of an episode that may have all of their samples, as [first, stop); at least one lies between two."""
        inside = np.array([[bound.start_ns, bound.stop_ns]], np.int64)
        cover = common([inside, *(covered(t.samples, t.rule, t.max_skew_s) for t in self._tracks.all)])
        found: list[tuple[int, int]] = []
        for start, stop in cover.tolist():
            first, end = (frames_until(bound.start_ns, at, self._asked.fps) for at in (start - 1, stop))
            if found and first <= found[-1][1]:
                first = found.pop()[0]
            if end > first:
                found.append((first, end))
        if (frames := sum(b - a for a, b in found)) > MAX_FRAMES:
            raise ConfigError(f"an episode has {frames} frames, {MAX_FRAMES} are allowed", where=self._log,
                                 mend="lower fps or max_skew_s, or part the log by marker or gap")
        return found

    def _columns(self, bound: Bounds, first: int, stop: int, bad: dict[int, str],
                 ) -> tuple[dict[str, Column], NDArray[np.bool_]]:
        """All columns of some frames, and which frames are whole; the values of the others mean nothing."""
        columns, good = self._tracks.blank(stop - first), np.ones(stop - first, np.bool_)
        for a in range(first, stop, PIECE):
            at = ticks(bound.start_ns, a, min(a + PIECE, stop), self._asked.fps)
            rows = slice(a - first, a - first + at.size)
            here, whole_here = {name: values[rows] for name, values in columns.items()}, good[rows]
            for track in self._tracks.all:
                whole_here &= track.fill(at, here)
            for row, text in self._not_finite(here, whole_here):
                bad[a + row] = f"{text} at frame {a + row}, {self._topic_of(text)}"
                whole_here[row] = False
        return columns, good

    def _not_finite(self, columns: Mapping[str, Column], good: NDArray[np.bool_]) -> Iterator[tuple[int, str]]:
        """The first value of each frame that is no number."""
        for name in self._asked.features:
            if np.isfinite(columns[name]).all():
                continue
            for row, value in np.argwhere(~np.isfinite(columns[name]) & good[:, None]).tolist():
                if good[row]:
                    wrong = columns[name][row, value]
                    yield row, f"{name}[{value}] is {'NaN' if np.isnan(wrong) else 'Inf' if wrong > 0 else '-Inf'}"

    def _topic_of(self, text: str) -> str:
        name, _, rest = text.partition("[")
        place = int(rest.partition("]")[0])
        return [t.topic for t in self._tracks.states if t.name == name and t.first <= place][-1]

    def _tell(self, number: int, bound: Bounds, runs: Sequence[Run], bad: Mapping[int, str]) -> None:
        """Say what is missing between the parts of an episode, or why nothing of it is left."""
        if not runs:
            why = f": {min(bad.items())[1]}" if bad else ""
            self._problems.append(f"episode {number} has no frame with all of its values{why}")
        for before, after in pairwise(runs):
            self._holes += 1
            if self._holes > TOLD:
                if self._holes == TOLD + 1:
                    self._problems.append("more frames are missing further on")
                return
            why = bad.get(before.stop) or self._absent(bound, before.stop)
            self._problems.append(f"episode {number} is parted at frame {before.stop}, "
                                  f"{after.first - before.stop} frames are missing: {why}")

    def _absent(self, bound: Bounds, frame: int) -> str:
        at = int(ticks(bound.start_ns, frame, frame + 1, self._asked.fps)[0])
        silent = next((t for t in self._tracks.all if t.silent_at(at)), None)
        return f"{silent.topic} has no sample within {silent.max_skew_s:g} s" if silent else "a value is missing"

    def _skews(self) -> dict[str, Skew]:
        found: dict[str, Skew] = {}
        for name, parts in self._distances.items():
            if parts:
                distances = np.concatenate([part.reshape(-1) for part in parts])
                found[name] = Skew(median_s=round(float(np.median(distances)), 9),
                                   max_s=round(float(distances.max()), 9))
        return found
