"""Judging: whether an attempt has succeeded or fails, as far as a robot can perceive it."""

import numpy as np

from pipeline.protocols import Observation
from pipeline.simulation.tasks import PickPlace
from pipeline.triggers import TRIGGERS, Senses, family, fired, senses_of
from schemas.recipe import HarvestConfig

_ONE = np.arange(1)
_ENDLESS = 1 << 30


def _senses(task: PickPlace) -> Senses:
    """Senses of one attempt that a person watches: no time is too long."""
    return senses_of(task, 1, HarvestConfig(), ticks=_ENDLESS)


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
        self._senses = _senses(self._task)

    def see(self, observation: Observation) -> None:
        """Take in one tick."""
        self._senses.update(observation, _ONE)

    def succeeded(self) -> bool:
        """Whether it believes in success now."""
        return bool(self._senses.succeeded(_ONE)[0])

    def phase(self) -> str:
        """Subtask reached: reach, carry or place."""
        return self._senses.phase(0)


class Alarm:
    """Notices that a policy fails, by the triggers that stop it at work; a person at the controls may do as they like.

    Args:
        task: its distances and hold time.
    """

    def __init__(self, task: PickPlace) -> None:
        self._task, self._senses = task, _senses(task)
        self.raised: tuple[str, str] | None = None
        """Trigger and failure family, once one has fired since the policy took command."""

    def reset(self) -> None:
        """The policy takes command, from here."""
        self._senses, self.raised = _senses(self._task), None

    def see(self, observation: Observation) -> bool:
        """Take in one tick of the policy's; whether the alarm is raised by it."""
        self._senses.update(observation, _ONE)
        index = int(fired(self._senses, _ONE)[0])
        if self.raised is not None or index < 0:
            return False
        trigger = list(TRIGGERS)[index]
        self.raised = trigger, family(trigger, self._senses.phase(0))
        return True
