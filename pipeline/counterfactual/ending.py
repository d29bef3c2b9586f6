"""Ending: an attempt ends where attempts at work end, by the robot's own senses; the truth is asked afterwards."""

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array, Ids, Observation
from pipeline.simulation.world import World
from pipeline.triggers import TRIGGERS, family, fired, senses_of
from schemas.recipe import HarvestConfig

UNNOTICED = "unnoticed"
"""In the place of a trigger: the robot believed in success, and the truth is another."""


class Ending:
    """Ends attempts once the robot believes in success, a trigger fires, or the time is up.

    Args:
        world: the attempts.
        triggers: thresholds that were in force at work.
    """

    def __init__(self, world: World, triggers: HarvestConfig) -> None:
        self.senses = senses_of(world.task, world.n, triggers)
        """They may be shown what happened before."""
        self._trigger = np.full(world.n, -1)
        self._phase = [""] * world.n

    def tick(self, tick: int, ids: Ids, observation: Observation, action: Array) -> NDArray[np.bool_]:
        """Take in one tick; returns which attempts end."""
        del tick, action
        self.senses.update(observation, ids)
        believed = self.senses.succeeded(ids)
        which = np.where(believed, -1, fired(self.senses, ids))
        self._trigger[ids] = which
        over = believed | (which >= 0)
        for i in ids[over].tolist():
            self._phase[i] = self.senses.phase(i)
        return over

    def why(self, attempt: int) -> str:
        """The failure family of an attempt that did not succeed in truth."""
        index = int(self._trigger[attempt])
        return family(UNNOTICED if index < 0 else list(TRIGGERS)[index], self._phase[attempt])
