"""The stand-in for a person who takes over: sees the scene, not the simulator, reacts late and aims imperfectly."""

import numpy as np

from pipeline.protocols import Array, Ids, Observation
from pipeline.simulation.expert import Expert
from pipeline.simulation.world import World
from schemas.recipe import HarvestConfig

GROSS_M = (0.03, 0.06)
"""How far a gross error misses [m]."""


def aim_error(seed: int, config: HarvestConfig) -> Array:
    """How far beside the object the stand-in aims in one attempt: x, y [m]; a gross error now and then."""
    rng = np.random.default_rng([seed, 11])
    error = rng.normal(0, config.operator_aim_sd_m, 2)
    angle, far, gross = rng.uniform(0, 2 * np.pi), rng.uniform(*GROSS_M), rng.random()
    if gross < config.operator_gross_error:
        error = far * np.array([np.cos(angle), np.sin(angle)])
    return error


class Operator:
    """Drives attempts from where they stand, as the expert would with these eyes.

    Args:
        world: the robots; the stand-in sees where the object lies, off by its aim error.
        config: reaction time, aim error, share of gross errors.
        seeds: one an attempt; they fix the aim error.
        perfect: the oracle arm: no delay and no aim error.
    """

    def __init__(self, world: World, config: HarvestConfig, seeds: list[int], *, perfect: bool = False) -> None:
        self._world, self._expert = world, Expert()
        self.delay = 0 if perfect else config.operator_delay_ticks
        self._aim = np.zeros((world.n, 2)) if perfect else np.array([aim_error(seed, config) for seed in seeds])
        self._tick = np.zeros(world.n, int)

    def reset(self, n: int) -> None:
        """Forget everything and prepare for n attempts."""
        self._expert.reset(n)
        self._tick = np.zeros(n, int)

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Hold still while reacting, then correct."""
        environment = observation.environment.copy()
        environment[:, :4] = self._world.truth(ids)
        environment[:, :2] += self._aim[ids]
        action = self._expert.act(Observation(observation.state, environment), ids)
        waiting = self._tick[ids] < self.delay
        action[waiting, :4], action[waiting, 4] = 0.0, observation.state[waiting, 15]
        self._tick[ids] += 1
        return action

    def memory(self, ids: Ids) -> Array:
        """Ticks so far and the expert's offsets, shape (len(ids), 4)."""
        return np.column_stack([self._tick[ids], self._expert.memory(ids)])
