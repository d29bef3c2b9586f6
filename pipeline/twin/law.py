"""The law from which twins are drawn: the hidden physics of the robot that training never sees.

Nothing but pipeline/twin/twin.py reads this file. Ranges reach beyond the training ranges on purpose, and the
structural terms (stiction, link flex, delay jitter, elliptic contacts) have no counterpart in training at all.
Everything was tuned on twins 0-9; figures come from twins 100-119.
"""

from collections.abc import Callable
from types import MappingProxyType

import numpy as np

type Draw = Callable[[np.random.Generator], float]

CONTINUOUS: MappingProxyType[str, Draw] = MappingProxyType({
    "kp": lambda rng: rng.uniform(0.5, 0.95),
    "damping": lambda rng: rng.uniform(0.8, 1.6),
    "frictionloss": lambda rng: rng.uniform(1.0, 3.0),
    "delay": lambda rng: float(rng.integers(1, 4)),
    "backlash": lambda rng: rng.uniform(0.0, 0.012),
    "friction": lambda rng: rng.uniform(0.4, 0.9),
    "mass": lambda rng: rng.uniform(0.05, 0.16),
    "bias_x": lambda rng: rng.normal(0, 0.006),
    "bias_y": lambda rng: rng.normal(0, 0.006),
    "noise": lambda rng: 0.0015,
    "jitter": lambda rng: rng.uniform(0.0, 0.3),
})
"""Field of pipeline.simulation.physics.Physics -> its draw, in that field's unit."""

STICTION_SHARE, STICTION = 0.4, (0.3, 1.5)
"""Share of twins with stiction, and its range relative to the nominal dry friction [1]."""
FLEX_SHARE, FLEX_N_M_RAD, FLEX_DAMPING = 0.4, (120.0, 400.0), 1.0
"""Share of twins whose forearm bends, and the stiffness of that bend [N m/rad]."""
CONTACT = MappingProxyType({"elliptic": True, "impratio": 3.0, "solref": (0.012, 1.0), "solimp": (0.9, 0.98, 0.001)})
"""Contact model of every twin; stable at 5 ms."""
