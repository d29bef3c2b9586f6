"""Robot: all that is believed of one robot, identified once from all that it sensed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.counterfactual.estimate_arm import ARM, LOWEST, ArmBelief, identify_arm
from pipeline.counterfactual.estimate_eyes import Eyes, identify_eyes, middle
from pipeline.counterfactual.estimate_log import SensedLog
from pipeline.counterfactual.moment import Lab
from pipeline.counterfactual.variation import SPREAD
from pipeline.simulation.physics import RANDOMIZATIONS, Physics, from_draws
from pipeline.simulation.tasks import load_task
from schemas.scene import SceneSpec

UNKNOWN = ("friction", "mass")
"""What the log hardly tells of the object: drawn from training's ranges."""


@dataclass(frozen=True, slots=True)
class Robot:
    """What is believed of one robot."""

    arm: ArmBelief
    eyes: Eyes
    middle_m: float
    """Where between the fingers an object is held, see estimate_eyes.middle [m]."""

    def draw(self, n: int, rng: np.random.Generator) -> Physics:
        """Physics that the robot may have, n rows: as far around the best as the log leaves open, and at least as
        far as the branches of an exact moment are drawn."""
        physics = from_draws([()] * n)
        sd = np.maximum(self.arm.sd, SPREAD * self.arm.values)
        drawn = np.maximum(self.arm.values + sd * rng.standard_normal((n, len(ARM))), LOWEST)
        for name, column in zip(ARM, drawn.T, strict=True):
            getattr(physics, name)[:] = column
        physics.delay[:], physics.jitter[:], physics.noise[:] = self.arm.delay, self.arm.jitter, self.eyes.noise
        for name in UNKNOWN:
            getattr(physics, name)[:] = [RANDOMIZATIONS[name](rng, 1.0) for _ in range(n)]
        physics.bias_x[:], physics.bias_y[:] = self.eyes.draw(n, rng).T
        return physics


def identify(logs: Sequence[SensedLog], scene: SceneSpec, lab: Lab, seed: int) -> Robot:
    """Identify a robot from its attempts.

    Args:
        logs: all that it sensed in them; the more, the better, and one is enough.
        scene: any start of its task, as perceived.
        lab: the simulation that stands in for the robot.
        seed: of all draws.
    """
    task, middle_m = load_task(scene.task), middle(scene, lab)
    halves = [task.nearest_half(float(log.environment[0, 2])) for log in logs]
    return Robot(identify_arm(logs, scene, lab, seed), identify_eyes(logs, halves, middle_m), middle_m)
