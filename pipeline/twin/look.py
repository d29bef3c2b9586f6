"""The law of looks: what the simulated real robot's camera sees, hidden from training like its physics.

As with the physics, ranges reach beyond those of training on purpose. A twin's camera is mounted once: its look is the
same in every attempt. Its randomness is its own, so that a twin's physics is what it was before it had a look.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from pipeline.simulation.appearance import LOOKS, Look

type Draw = Callable[[np.random.Generator], float]

LAW: Mapping[str, Draw] = MappingProxyType({
    "look_light": lambda rng: rng.uniform(0.65, 1.3),
    "look_warmth": lambda rng: rng.uniform(-0.18, 0.18),
    "look_lamp_x": lambda rng: rng.uniform(-0.6, 1.0),
    "look_lamp_y": lambda rng: rng.uniform(-1.0, 1.0),
    "look_table": lambda rng: rng.uniform(0.55, 1.2),
    "look_table_red": lambda rng: rng.uniform(-0.15, 0.15),
    "look_table_blue": lambda rng: rng.uniform(-0.15, 0.15),
    "look_texture": lambda rng: rng.uniform(0.1, 0.45),
    "look_grain": lambda rng: rng.uniform(0.0, 1.0),
    "look_pattern": lambda rng: float(rng.integers(1 << 16, 1 << 17)),
    "look_object": lambda rng: rng.uniform(-0.12, 0.12),
    "look_camera_x": lambda rng: rng.normal(0, 0.008),
    "look_camera_y": lambda rng: rng.normal(0, 0.008),
    "look_camera_z": lambda rng: rng.normal(0, 0.008),
    "look_camera_pan": lambda rng: rng.normal(0, 0.012),
    "look_camera_tilt": lambda rng: rng.normal(0, 0.012),
    "look_camera_roll": lambda rng: rng.normal(0, 0.012),
})
"""Name of a trait -> its draw. No texture of a twin is one of training: its numbers begin where theirs end."""


def twin_look(seed: int) -> Look:
    """What the scene of the twin of that seed looks like, always the same."""
    rng = np.random.default_rng([0x100C, seed])
    return MappingProxyType({name: float(LAW[name](rng)) for name in LOOKS})
