"""Variation: the noise and the physics under which a moment is played again.

A recording shows one draw of what might have happened. Perception noise and delay jitter are drawn anew for every
branch, and the physics is drawn closely around the recorded robot's: wide enough that a verdict does not hang on the
third digit of a friction, far narrower than training's own ranges, since the robot is known to be this one. Delay,
play's presence, stiction, jitter and the structure of the robot stay as they are.
"""

from collections.abc import Callable, Sequence
from types import MappingProxyType

import numpy as np

from pipeline.simulation.physics import NOMINAL, UNITS
from pipeline.simulation.tasks import scene_seed
from schemas.scene import Draw, SceneSpec

SPREAD = 0.03
"""Standard deviation of the factors [1]."""
BIAS_SD_M = 0.0005
"""Standard deviation of the change of the perceived position's error [m]."""


def _factor(value: float, rng: np.random.Generator) -> float:
    return float(value * np.exp(rng.normal(0, SPREAD)))


def _shift(value: float, rng: np.random.Generator) -> float:
    return float(value + rng.normal(0, BIAS_SD_M))


type Vary = Callable[[float, np.random.Generator], float]
"""(the robot's own value, generator) -> a value close by."""

VARIATIONS: MappingProxyType[str, Vary] = MappingProxyType({
    "kp": _factor, "damping": _factor, "frictionloss": _factor, "backlash": _factor, "friction": _factor,
    "mass": _factor, "bias_x": _shift, "bias_y": _shift,
})
"""Parameter of Physics -> how a branch draws it."""


def branch_seed(scene: SceneSpec, tick: int, branch: int, seed: int) -> int:
    """Seed of one branch: of its noise and of its physics, the same for both policies."""
    return scene_seed("study", scene.seed, tick, branch, seed)


def vary(draws: Sequence[Draw], seed: int) -> tuple[Draw, ...]:
    """The physics of one branch around the recorded robot's.

    Args:
        draws: the robot's own; what it does not name is nominal.
        seed: of the branch.
    """
    own = {name: NOMINAL[name] for name in VARIATIONS} | {d.name: d.value for d in draws}
    rng = np.random.default_rng([seed, 13])
    varied = own | {name: law(own[name], rng) for name, law in VARIATIONS.items()}
    return tuple(Draw(name=name, unit=UNITS[name], value=value) for name, value in varied.items())
