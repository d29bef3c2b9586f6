"""What a ring keeps, and one of its files at full rate."""

from concurrent.futures import Future
from dataclasses import dataclass

from pipeline.errors import RecordingError
from pipeline.recording.live import Closed, LiveRecorder
from pipeline.recording.write import part_of
from schemas.episode import Outcome


@dataclass(frozen=True, slots=True)
class Ring:
    """What is kept."""

    before_s: float = 10.0
    """At full rate before a trigger, at least [s]; at most twice that."""
    after_s: float = 5.0
    """At full rate after the last trigger of a window [s]."""
    every: int = 10
    """Of the rest, one tick in so many."""


@dataclass(slots=True, eq=False)
class Lap:
    """A file at full rate, from tick `first` on."""

    recorder: LiveRecorder
    first: int = 0
    until: int | None = None
    """Last tick to keep; None while nothing has happened."""
    outcome: Outcome | None = None


def end(lap: Lap) -> Closed | None:
    """Close a window; throw a file away in which nothing happened."""
    if lap.until is None:
        lap.recorder.abandon()
        part_of(lap.recorder.path).unlink(missing_ok=True)
        return None
    return lap.recorder.close(lap.outcome)


def throw_away(begun: Future[Lap]) -> None:
    """A file that was opened ahead and never begun."""
    try:
        lap = begun.result()
    except RecordingError:
        return
    lap.recorder.abandon()
    part_of(lap.recorder.path).unlink(missing_ok=True)
