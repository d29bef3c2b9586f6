"""Framing: episodes laid out on the even clock of a map, out of spooled samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.logs.episodes import Bounds, Event, by_gap, by_marker, common, covered, labels, whole
from pipeline.logs.filling import Filler
from pipeline.logs.intake import EventIntake
from pipeline.logs.mapping import EXAMPLE
from pipeline.logs.resample import NS, frames_until, ticks
from pipeline.logs.tables import FrameWriter
from pipeline.logs.tracks import SKEW, Tracks
from schemas.conversion import Converted, Skew, Span
from schemas.ingest import Gap, IngestMap, Marker, TopicOutcome

MAX_FRAMES = 5_000_000
"""Frames of one episode: 28 hours at 50 Hz; more means a clock that is not one."""
MAX_EPISODES = 100_000
"""Episodes and parts of one log."""
TOLD = 20
"""Holes of a log that are told one by one."""


@dataclass(frozen=True, slots=True)
class Run:
    """Frames `first` to before `stop` of an episode, every one with all of its values."""

    first: int
    stop: int


class Framing:
    """Lays out what was taken of one log; `problems` grows with what is missing or left out."""

    def __init__(self, asked: IngestMap, taken: Tracks, events: Sequence[EventIntake], log: Path,
                 problems: list[str]) -> None:
        self._asked, self._tracks, self._log, self._problems = asked, taken, log, problems
        self._events: dict[Marker | TopicOutcome, list[Event]] = {e.wanted: e.events for e in events}
        self._distances: dict[str, list[NDArray[np.float32]]] = {t.name: [] for t in taken.all}
        self._cover = common([covered(t.samples, t.rule, t.max_skew_s) for t in taken.all])
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
            filler = Filler(self._tracks, bound, self._asked.fps, self._asked.features)
            for part, run in enumerate(self._runs(number, bound, filler)):
                if run.stop - run.first < self._asked.min_frames:
                    short += 1
                    continue
                for columns in filler.pieces(run.first, run.stop):
                    writer.append(columns)
                    for name, found in self._distances.items():
                        found.append(np.abs(columns[SKEW + name]).astype(np.float32))
                start = int(ticks(bound.start_ns, run.first, run.first + 1, self._asked.fps)[0])
                spans.append(Span(boundary=number, part=part, start_ns=start, frames=run.stop - run.first, label=label))
                self._refuse_crumbs(len(spans))
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
        if len(self._cover):
            return
        late, early = max(taken, key=lambda t: t.samples.span[0]), min(taken, key=lambda t: t.samples.span[1])
        apart = (late.samples.span[0] - early.samples.span[1]) / NS
        how = f"{late.topic} begins {apart:.3g} s after {early.topic} ends, by {late.clock} and {early.clock} time" \
            if apart > 0 else "no sample of one lies near enough to a sample of each other"
        raise ConfigError(f"the topics have no time in common: {how}", where=self._log,
                          mend=f"declare one clock for all, or a larger max_skew_s; {EXAMPLE}")

    def _refuse_crumbs(self, spans: int) -> None:
        if spans > MAX_EPISODES:
            raise ConfigError(f"more than {MAX_EPISODES} episodes or parts", where=self._log,
                              mend="declare a larger max_skew_s, a lower fps or a larger min_frames")

    def _runs(self, number: int, bound: Bounds, filler: Filler) -> list[Run]:
        """The parts of one episode; what is missing between them is told, or refuses the episode."""
        runs: list[Run] = []
        for first, stop in self._segments(bound):
            edges = np.flatnonzero(np.diff(filler.good(first, stop), prepend=False, append=False)).reshape(-1, 2)
            runs += [Run(first + a, first + b) for a, b in edges.tolist()]
        self._tell(number, bound, runs, filler.bad)
        if len(runs) > 1 and self._asked.missing == "refuse":
            self._problems.append(f"episode {number} is refused: frames are missing in it")
            return []
        return runs

    def _segments(self, bound: Bounds) -> list[tuple[int, int]]:
        """Frames of an episode that may have all of their samples, as [first, stop); at least one lies between two."""
        inside = np.array([[bound.start_ns, bound.stop_ns]], np.int64)
        found: list[tuple[int, int]] = []
        for start, stop in common([inside, self._cover]).tolist():
            first, end = (frames_until(bound.start_ns, at, self._asked.fps) for at in (start - 1, stop))
            if found and first <= found[-1][1]:
                first = found.pop()[0]
            if end > first:
                found.append((first, end))
        if (frames := sum(b - a for a, b in found)) > MAX_FRAMES:
            raise ConfigError(f"an episode has {frames} frames, {MAX_FRAMES} are allowed", where=self._log,
                              mend="lower fps or max_skew_s, or part the log by marker or gap")
        return found

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
