"""Judging: whether an attempt has succeeded, as far as a robot can perceive it."""

import numpy as np

from pipeline.protocols import Observation
from pipeline.simulation.tasks import PickPlace
from pipeline.triggers import Senses
from schemas.recipe import HarvestConfig

LOW_M = 0.012
"""Perceived height above rest that still counts as on the table [m]: six standard deviations of the noise."""
_ONE = np.arange(1)


class Judge:
    """Believes in success when the object is perceived on the mark and let go, for the task's hold time.

    Args:
        task: its distances and hold time.
    """

    def __init__(self, task: PickPlace) -> None:
        self._task = task
        self.reset()

    def reset(self) -> None:
        """Forget everything: another attempt begins."""
        t = self._task
        self._senses = Senses(1, t.ticks, HarvestConfig(), within_m=t.within_m, away_m=t.hand_away_m, open_m=t.open_m,
                              low_m=LOW_M, hold=t.hold_ticks)

    def see(self, observation: Observation) -> None:
        """Take in one tick."""
        self._senses.update(observation, _ONE)

    def succeeded(self) -> bool:
        """Whether it believes in success now."""
        return bool(self._senses.succeeded(_ONE)[0])

    def phase(self) -> str:
        """Subtask reached: reach, carry or place."""
        return self._senses.phase(0)
