"""LeggedModel: nominal legged robots on which plans are tried; a task's rewards are what they cost."""

import numpy as np

from pipeline.control.broken import broken, forget
from pipeline.control.config import SamplingConfig
from pipeline.control.legged import LeggedPlant, LeggedSensed
from pipeline.locomotion.world import LeggedWorld
from pipeline.protocols import Array

FALL = 20.0
"""What each step of a plan after a fall costs, in units of a step's rewards."""


class LeggedModel:
    """n robots times k plans in one LeggedWorld: what a plan costs is what the task does not reward it with.

    Every term of the task's reward is of each step of a plan, and a step after a fall costs FALL; pushes to come are
    not known to it.

    Args:
        plant: the robots; the model is their nominal one.
        config: k, and the steps of a plan.
        threads: threads of the engine; results do not depend on them.
    """

    def __init__(self, plant: LeggedPlant, config: SamplingConfig, *, threads: int = 1) -> None:
        engine = plant.clock_hz
        task = plant.task.model_copy(update={
            "control_hz": 1 / config.step_s, "substeps": max(1, round(engine * config.step_s))})
        self._world = LeggedWorld(plant.body, task, plant.n * config.samples, threads=threads)
        self._slower = task.control_hz / engine
        self.low, self.high = np.full(self._world.action_size, -1.0), np.full(self._world.action_size, 1.0)

    def costs(self, sensed: LeggedSensed, command: Array, actions: Array) -> Array:
        """Costs (n, k) of shares (n, k, steps, joints); see pipeline.control.sampling.Model."""
        n, k, steps, joints = actions.shape
        world = self._world
        kept = {name: np.repeat(values, k, axis=0) for name, values in sensed.world.items()}
        kept["ticks"] = np.round(kept["ticks"] * self._slower)
        kept["blows"], kept["next_blow"] = np.zeros((n * k, 0, 3)), np.zeros(n * k)
        kept["command"] = np.repeat(command, k, axis=0)
        world.load(kept)
        forget(world.batch)
        fallen, cost = np.zeros(n * k, bool), np.zeros(n * k)
        for step in range(steps):
            world.act(actions[:, :, step].reshape(n * k, joints))
            now = world.motion()
            fallen |= world.fallen(now)
            cost += np.where(fallen, FALL, -np.sum(list(world.rewards(now).values()), axis=0))
        return np.where(broken(world.batch), np.inf, cost).reshape(n, k)
