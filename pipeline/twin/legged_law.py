"""The law from which legged twins are drawn: the hidden physics of the robot that training never sees.

Nothing but pipeline/twin/legged.py reads this file. Training knows the nominal robot, without noise, delay or load.
Everything was tuned on twins 0-9; figures come from twins 100 and on.
"""

from collections.abc import Callable
from types import MappingProxyType

import numpy as np

type Draw = Callable[[np.random.Generator], float]

LAW: MappingProxyType[str, tuple[str, Draw]] = MappingProxyType({
    "payload": ("1", lambda rng: rng.uniform(0.03, 0.12)),
    "payload_x": ("1", lambda rng: rng.uniform(-0.06, 0.06)),
    "payload_y": ("1", lambda rng: rng.uniform(-0.04, 0.04)),
    "payload_z": ("1", lambda rng: rng.uniform(0.0, 0.35)),
    "strength": ("1", lambda rng: rng.uniform(0.8, 1.0)),
    "stiffness": ("1", lambda rng: rng.uniform(0.85, 1.0)),
    "damping": ("1", lambda rng: rng.uniform(0.8, 1.5)),
    "dry_friction": ("1", lambda rng: rng.uniform(0.0, 0.02)),
    "delay_s": ("s", lambda rng: rng.uniform(0.0, 0.007)),
    "ground": ("1", lambda rng: rng.uniform(0.4, 0.9)),
    "turning_bias": ("rad/s", lambda rng: rng.normal(0, 0.02)),
    "turning_noise": ("rad/s", lambda rng: rng.uniform(0.01, 0.03)),
    "tilt_bias_x": ("rad", lambda rng: rng.normal(0, 0.01)),
    "tilt_bias_y": ("rad", lambda rng: rng.normal(0, 0.01)),
    "tilt_noise": ("rad", lambda rng: rng.uniform(0.002, 0.006)),
    "joint_bias": ("rad", lambda rng: rng.uniform(0.0, 0.01)),
    "joint_noise": ("rad", lambda rng: rng.uniform(0.0005, 0.002)),
    "rate_noise": ("rad/s", lambda rng: rng.uniform(0.02, 0.06)),
    "blows": ("1", lambda rng: rng.uniform(1.0, 1.25)),
})
"""What is hidden -> its unit and its draw.

payload is a load on the base as a share of the robot's mass, at x, y, z as shares of the base's height at home;
strength and stiffness are of the motors, relative to their data sheet; damping of the joints likewise; dry friction is
a share of each motor's limit; ground is the sliding friction of the feet; blows are relative to the task's.
"""

CONTACT = MappingProxyType({"elliptic": True, "impratio": 1.0, "solref": (0.015, 1.0), "solimp": (0.9, 0.97, 0.001)})
"""Contact model of every legged twin; stable at 5 ms."""
