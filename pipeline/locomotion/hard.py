"""Hard starts: how a legged robot stood some time before it fell, from what it sensed and never from the truth."""

import numpy as np

from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.odometry import LegOdometry
from pipeline.locomotion.sensed import sensed
from pipeline.protocols import Array
from schemas.legged import LeggedStart

ABOUT_TICKS = 1
"""The speed of the base is found from so many ticks before and after, too: feet bounce."""
ROWS = 2 * ABOUT_TICKS + 1
"""Robots that the kinematics must have."""


def start_before(state: Array, tick: int, body: LeggedBody, legs: LegOdometry) -> LeggedStart:
    """The start that a robot's senses give for one tick of its attempt.

    The heading is 0 and the place is the origin: no task depends on them. What will push it is not known.

    Args:
        state: what the robot sensed, shape (m, w); see LeggedWorld.observe.
        tick: row of it.
        body: the robot as its maker knows it.
        legs: its kinematics, for ROWS robots.
    """
    now = sensed(state[tick:tick + 1], body)
    speed = legs.velocity(sensed(state[max(0, tick - ABOUT_TICKS):tick + ABOUT_TICKS + 1], body))
    return LeggedStart.model_validate({
        "height_m": float(legs.height(now, np.arange(1))[0]), "quaternion": now.upright[0].tolist(),
        "velocity": [*speed.tolist(), *now.turning[0].tolist()],
        "bend": (now.joints[0] - np.array(body.home)).tolist(), "rates": now.rates[0].tolist(),
        "command": now.command[0].tolist()})
