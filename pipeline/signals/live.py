"""One robot's champion watched in real time: its signals at every tick, and the moments that a ring should keep."""

from collections.abc import Mapping

import numpy as np

from pipeline.protocols import Array, Observation
from pipeline.signals.neighbours import Neighbours
from pipeline.signals.tick import Signals
from pipeline.signals.warning import ALARM, ALARM_TICKS
from pipeline.simulation.tasks import PickPlace
from pipeline.triggers import TRIGGERS, fired, senses_of
from schemas.recipe import HarvestConfig, LastingConfig

_ONE = np.arange(1)
_ENDLESS = 1 << 30
WARNED = "warning"
"""Name of the moment at which the early warning has been above its alarm for long enough."""


class LiveWatch:
    """Signals and triggers of one attempt at a time; a disagreement that lasts is one of them.

    Args:
        task: its distances and hold time.
        neighbours: what the champion learnt from, where it is known.
    """

    def __init__(self, task: PickPlace, neighbours: Neighbours | None = None) -> None:
        self._task, self._neighbours = task, neighbours
        self.begin()

    def begin(self) -> None:
        """An attempt begins."""
        self._signals = Signals(1, self._neighbours)
        self._senses = senses_of(self._task, 1, HarvestConfig(disagreement=LastingConfig()), ticks=_ENDLESS)
        self._standing, self._warned, self._over = -1, 0, False

    def tick(self, observation: Observation, action: Array, answers: Mapping[str, Array],
             plan: Array | None) -> tuple[dict[str, float], str | None]:
        """Signal -> value, and the name of a trigger that has fired just now; see Signals.tick, of one attempt.

        What is noticed stands until it ends: it fires once. After a success nothing fires any more.
        """
        found = self._signals.tick(observation, action, answers, _ONE, plan)
        self._senses.update(observation, _ONE)
        if "apart" in found:
            self._senses.differ(found["apart"], _ONE)
        before, self._standing = self._standing, int(fired(self._senses, _ONE)[0])
        alarming = "warning" in found and bool(found["warning"][0] > ALARM)
        self._warned = self._warned + 1 if alarming else 0
        self._over = self._over or bool(self._senses.succeeded(_ONE)[0])
        noticed = None
        if self._standing >= 0 and self._standing != before:
            noticed = list(TRIGGERS)[self._standing]
        elif self._warned == ALARM_TICKS:
            noticed = WARNED
        return {name: float(value[0]) for name, value in found.items()}, None if self._over else noticed
