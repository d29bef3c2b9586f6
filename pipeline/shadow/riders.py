"""Riders: any number of candidates beside the champion, each in a process of its own."""

import select
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from pipeline.protocols import Array, Ids, Observation
from pipeline.shadow import wire
from pipeline.shadow.candidate import OVER, Candidate
from pipeline.shadow.limits import Limits
from pipeline.shadow.sizes import ARM, Sizes

LOOK_S = 0.25
"""How often a clock that waits looks whether a candidate has been silent for too long [s]."""


class Riders:
    """Candidates in the champion's shadow: they see what it sees, and nothing that they do reaches robot or champion.

    No method but `ready`, `states`, `close` and a patient `answers` waits, and none raises because of a candidate: one
    that is refused, crashes or hangs is silent from then on, one that is late or answers NaN is silent for that tick,
    and `states` says why. All methods are called in the thread that made it: the kernel ends the candidates with it.

    Args:
        candidates: id of a policy -> its ONNX file; their order is kept.
        limits: of each.
        patient: whether the clock waits for answers, as it can in simulation; then the same candidates give the same
            bits every time. Without, an answer that is not there when it is asked for is late.
        sizes: what they are asked; of the reference arm where not given.
    """

    def __init__(self, candidates: Mapping[str, Path], limits: Limits | None = None, *, patient: bool,
                 sizes: Sizes = ARM) -> None:
        limits = limits or Limits()
        self._patient, self._epoch, self._attempts, self._number = patient, 0, 0, 0
        self._told: dict[str, str] = dict.fromkeys(candidates, "running")
        self._all: list[Candidate] = []
        try:
            for id, file in candidates.items():
                self._all.append(Candidate(id, file, limits, patient=patient, sizes=sizes))
        except BaseException:
            self.close()
            raise

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of all candidates, in their order, whatever became of them."""
        return tuple(candidate.id for candidate in self._all)

    def ready(self) -> None:
        """Wait until each candidate has loaded its file or failed at it: before the robot moves, not while it does."""
        self._wait(lambda candidate: candidate.word == "starting", counts=False)

    def reset(self, n: int) -> None:
        """Have all forget everything and prepare for n attempts."""
        self._epoch, self._attempts = self._epoch + 1, n

    def offer(self, observation: Observation, ids: Ids) -> None:
        """Show all candidates what attempts `ids` perceive at this tick; never waits."""
        packets: list[tuple[int, slice, bytes]] = []
        most = wire.rows_at_once(observation.state.shape[1] + observation.environment.shape[1])
        for first in range(0, len(ids), most):
            place = slice(first, min(first + most, len(ids)))
            part = Observation(observation.state[place], observation.environment[place])
            packet = wire.question(self._epoch, self._attempts, self._number, ids[place], part)
            packets.append((self._number, place, packet))
            self._number += 1
        for candidate in self._all:
            candidate.tick(packets, len(ids))

    def answers(self) -> Mapping[str, Array]:
        """Candidate -> its actions (len(ids), width) for what was offered last.

        Every candidate is in it; rows are NaN, whole, where it is silent, late or broken.
        """
        for candidate in self._all:
            candidate.hear()
        if self._patient:
            self._wait(lambda candidate: candidate.asked, counts=True)
        return {candidate.id: candidate.settle() for candidate in self._all}

    def states(self) -> Mapping[str, str]:
        """Candidate -> what became of it: running, late, broken, slow, hung, crashed or refused, and why.

        For after the work: it waits a moment for one that is just ending, to say how.
        """
        return {candidate.id: candidate.state(wait=True) for candidate in self._all}

    def fences(self) -> Mapping[str, str]:
        """Candidate -> what its process gave up, as it said when it was ready."""
        return {candidate.id: candidate.fence for candidate in self._all}

    def news(self) -> Sequence[tuple[str, str]]:
        """(candidate, state) of each that is not as it was told last, for the recording's events.

        That it is late or broken is told once: a slow one is late at every other tick.
        """
        found: list[tuple[str, str]] = []
        for candidate in self._all:
            told = self._told[candidate.id]
            if candidate.word not in ("starting", "running", told) and (candidate.word in OVER or told == "running"):
                self._told[candidate.id] = candidate.word
                found.append((candidate.id, candidate.state()))
        return found

    def pids(self) -> Mapping[str, int]:
        """Candidate -> id of its process, while it is asked anything."""
        return {candidate.id: pid for candidate in self._all if (pid := candidate.pid) is not None}

    def close(self) -> None:
        """End all processes; may be called twice."""
        for candidate in self._all:
            candidate.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def _wait(self, awaited: Callable[[Candidate], bool], *, counts: bool) -> None:
        """Let time pass until nobody is awaited any more, by an answer or by a limit; it may count as waited for."""
        while waiting := [candidate for candidate in self._all if awaited(candidate)]:
            poll, began = select.poll(), time.monotonic()
            for candidate in waiting:
                poll.register(candidate, select.POLLIN)
            poll.poll(LOOK_S * 1000)
            for candidate in waiting:
                candidate.hear()
                candidate.waited(time.monotonic() - began if counts else 0.0)
