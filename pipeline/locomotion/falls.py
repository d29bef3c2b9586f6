"""Falls: what a legged robot notices of its own balance, from its own senses alone."""

from collections.abc import Callable
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.odometry import LegOdometry
from pipeline.locomotion.sensed import sensed
from pipeline.locomotion.tasks import LeggedTask
from pipeline.protocols import Ids, Observation

RISE_S = 1.0
"""For so long an attempt is still about its start [s]."""
SIDE_RAD = np.pi / 4
"""A fall that is turned further than this from straight ahead, or straight back, is one to the side."""


class FallSenses:
    """What n legged robots notice of their balance; rows are attempts.

    Args:
        body: the robot as its maker knows it.
        task: says when an attempt has failed.
        n: attempts.
        threads: threads of the engine that computes kinematics.
    """

    def __init__(self, body: LeggedBody, task: LeggedTask, n: int, *, threads: int = 1) -> None:
        self.body, self.task = body, task
        self._legs = LegOdometry(body, n, threads=threads)
        self.tick = np.zeros(n, np.int64)
        self.lean = np.zeros(n)
        """How far the base leans [rad]."""
        self.height = np.ones(n)
        """Height of the base over the lowest foot, as a share of that at home."""
        self.toward = np.zeros(n)
        """Where it leans to: 0 is forward, pi / 2 left [rad]."""
        self.asked = np.zeros(n, bool)
        """Whether it is asked to walk."""

    def update(self, observation: Observation, ids: Ids) -> None:
        """Take in what was perceived at one tick."""
        now = sensed(observation.state, self.body)
        self.lean[ids] = np.arccos(np.clip(now.up[:, 2], -1, 1))
        self.toward[ids] = np.arctan2(-now.up[:, 1], -now.up[:, 0])
        self.height[ids] = self._legs.height(now, ids) / self.body.height_m
        self.asked[ids] = (now.command != 0).any(axis=1)
        self.tick[ids] += 1

    def phase(self, attempt: int) -> str:
        """'rise' within the first second, then 'walk' where a speed is asked for, else 'hold'."""
        if self.tick[attempt] <= RISE_S * self.task.control_hz:
            return "rise"
        return "walk" if self.asked[attempt] else "hold"

    def direction(self, attempt: int) -> str:
        """Where the base leans to: forward, backward or sideways."""
        off = abs(self.toward[attempt])
        return "forward" if off <= SIDE_RAD else "backward" if off >= np.pi - SIDE_RAD else "sideways"


def fell(s: FallSenses) -> NDArray[np.bool_]:
    """The base leans beyond the task's limit."""
    return ~(s.lean <= s.task.fallen_rad)  # so that a robot whose IMU tells no number has fallen, too


def sank(s: FallSenses) -> NDArray[np.bool_]:
    """The base is lower over the lowest foot than the task allows."""
    return s.height < s.task.fallen_height


type FallTrigger = Callable[[FallSenses], NDArray[np.bool_]]

FALL_TRIGGERS: MappingProxyType[str, FallTrigger] = MappingProxyType({"fell": fell, "sank": sank})
"""Trigger name -> rule, asked in this order. Add one: a function of FallSenses and an entry here."""


def fallen(senses: FallSenses, ids: Ids) -> NDArray[np.int64]:
    """Index in FALL_TRIGGERS of the first rule that fires, -1 where none does, shape (len(ids),)."""
    out = np.full(len(ids), -1)
    for index, rule in reversed(list(enumerate(FALL_TRIGGERS.values()))):
        out[rule(senses)[ids]] = index
    return out


def fall_family(trigger: str, senses: FallSenses, attempt: int) -> str:
    """Failure family: what was noticed, where to, and when: fell-forward-rise, sank-hold, ..."""
    phase = senses.phase(attempt)
    return f"{trigger}-{senses.direction(attempt)}-{phase}" if trigger == "fell" else f"{trigger}-{phase}"
