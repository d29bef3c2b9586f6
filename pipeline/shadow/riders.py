"""Riders: any number of candidates beside the champion, each in a process of its own."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from pipeline.protocols import Array, Ids, Observation
from pipeline.shadow.limits import Limits


class Riders:
    """Candidates in the champion's shadow: they see what it sees, and nothing that they do reaches robot or champion.

    No method but `ready` and a patient `answers` waits, and none raises because of a candidate: one that is refused,
    crashes, hangs, is slow or answers NaN is silent from then on, and `states` says why. For one thread.

    Args:
        candidates: id of a policy -> its ONNX file; their order is kept.
        limits: of each.
        patient: whether the clock waits for answers, as it can in simulation; then the same candidates give the same
            bits every time. Without, an answer that is not there when it is asked for is late.
    """

    def __init__(self, candidates: Mapping[str, Path], limits: Limits | None = None, *, patient: bool) -> None:
        raise NotImplementedError

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of all candidates, in their order, whatever became of them."""
        raise NotImplementedError

    def ready(self) -> None:
        """Wait until each candidate has loaded its file or failed at it: before the robot moves, not while it does."""
        raise NotImplementedError

    def reset(self, n: int) -> None:
        """Have all forget everything and prepare for n attempts."""
        raise NotImplementedError

    def offer(self, observation: Observation, ids: Ids) -> None:
        """Show all candidates what attempts `ids` perceive at this tick; never waits."""
        raise NotImplementedError

    def answers(self) -> Mapping[str, Array]:
        """Candidate -> its actions (len(ids), 5) for what was offered last.

        Every candidate is in it; rows are NaN, whole, where it is silent, late or broken.
        """
        raise NotImplementedError

    def states(self) -> Mapping[str, str]:
        """Candidate -> what became of it: 'running', 'late', 'crashed', 'hung', 'slow', 'refused', 'broken': why."""
        raise NotImplementedError

    def news(self) -> Sequence[tuple[str, str]]:
        """(candidate, state) of every candidate that got worse since the last call; for the recording's events."""
        raise NotImplementedError

    def pids(self) -> Mapping[str, int]:
        """Candidate -> id of its process, while it lives."""
        raise NotImplementedError

    def close(self) -> None:
        """End all processes; may be called twice."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()
