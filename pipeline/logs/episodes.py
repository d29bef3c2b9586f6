"""Episode boundaries: where a log is parted, by the file, by silence, or by what a topic says."""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.logs.resample import NS
from pipeline.logs.spool import Samples
from schemas.ingest import Marker, Rule, SaidOutcome, TopicOutcome, Value

type Label = Literal["success", "failure", "unknown"]
type Intervals = NDArray[np.int64]
"""Times [ns], shape (n, 2): first and last, both included, in order and apart from each other."""
type Event = tuple[int, Value]
"""When a topic said something [ns], and what."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """One episode by the declared boundaries."""

    start_ns: int
    """Time of frame 0."""
    stop_ns: int
    """Latest time of a frame."""


def whole(samples: Sequence[Samples]) -> list[Bounds]:
    """One episode, from when every topic has spoken until none does any more."""
    spans = [s.span for s in samples]
    start, stop = max(first for first, _ in spans), max(last for _, last in spans)
    return [Bounds(start, stop)]


def by_gap(samples: Sequence[Samples], silent: Sequence[Samples], longer_than_s: float) -> list[Bounds]:
    """Episodes between silences of `silent` together; each begins when every topic has spoken in it."""
    gap = round(longer_than_s * NS)
    found: list[Bounds] = []
    for start, stop in union([s.runs(gap) for s in silent], gap).tolist():
        firsts = [s.next_from(start) for s in samples]
        begin = max((first for first in firsts if first is not None), default=None)
        if None not in firsts and begin is not None and begin <= stop:
            found.append(Bounds(begin, stop))
    return found


def by_marker(events: Iterable[Event], marker: Marker, last_ns: int) -> tuple[list[Bounds], list[str]]:
    """Episodes from a start value to the next stop value, and what was odd about them.

    A start that repeats while an episode is open says nothing new, unless there are no stop values: then it
    begins the next. An episode that no stop ends goes on to the last sample.
    """
    found: list[Bounds] = []
    odd: list[str] = []
    start: int | None = None
    for stamp, value in sorted(events, key=lambda event: event[0]):
        if value in marker.start:
            if start is not None and not marker.stop:
                found.append(Bounds(start, stamp - 1))
            if start is None or not marker.stop:
                start = stamp
        elif value in marker.stop and start is not None:
            found.append(Bounds(start, stamp))
            start = None
    if start is not None:
        if marker.stop:
            odd.append(f"{marker.topic} does not end episode {len(found)}; it goes on to the last sample")
        found.append(Bounds(start, max(last_ns, start)))
    if not found:
        odd.append(f"{marker.topic} never says {' or '.join(map(repr, marker.start))}; no episode begins")
    return found, odd


def labels(bounds: Sequence[Bounds], outcome: SaidOutcome | TopicOutcome, events: Iterable[Event]) -> list[Label]:
    """How each episode ended: the last value that was said from its start until the next one begins."""
    if isinstance(outcome, SaidOutcome):
        return [outcome.label] * len(bounds)
    told = sorted(events, key=lambda event: event[0])
    stamps = [stamp for stamp, _ in told]
    found: list[Label] = []
    for k, episode in enumerate(bounds):
        until = bisect_left(stamps, bounds[k + 1].start_ns) if k + 1 < len(bounds) else len(told)
        last = told[until - 1][1] if until > bisect_left(stamps, episode.start_ns) else None
        found.append("success" if last in outcome.success else "failure" if last in outcome.failure else "unknown")
    return found


def covered(samples: Samples, rule: Rule, max_skew_s: float) -> Intervals:
    """Where frames may have an admissible sample; outside there is none, inside `pick` decides."""
    reach = round(max_skew_s * NS)
    runs = samples.runs(reach if rule == "hold" else 2 * reach)
    return runs + np.array({"hold": (0, reach), "nearest": (-reach, reach), "linear": (0, 0)}[rule])


def union(parts: Iterable[Intervals], gap: int = 0) -> Intervals:
    """Intervals that lie in any of the parts; those at most `gap` apart become one."""
    everything = np.concatenate([np.zeros((0, 2), np.int64), *parts])
    everything = everything[np.argsort(everything[:, 0], kind="stable")]
    if not len(everything):
        return everything
    reached = np.maximum.accumulate(everything[:, 1])
    fresh = np.append(True, everything[1:, 0] - reached[:-1] > gap)
    last = np.append(np.flatnonzero(fresh)[1:] - 1, len(everything) - 1)
    return np.stack([everything[fresh, 0], reached[last]], axis=1)


def common(parts: Sequence[Intervals]) -> Intervals:
    """Intervals that lie in all of the parts."""
    result = union(parts[:1])
    for part in map(union, [[p] for p in parts[1:]]):
        at = np.searchsorted(part[:, 1], result[:, 0])
        until = np.searchsorted(part[:, 0], result[:, 1], "right")
        count = np.maximum(until - at, 0)
        left = np.repeat(np.arange(len(result)), count)
        right = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count) + np.repeat(at, count)
        result = np.stack([np.maximum(result[left, 0], part[right, 0]), np.minimum(result[left, 1], part[right, 1])], 1)
    return result
