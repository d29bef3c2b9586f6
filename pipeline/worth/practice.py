"""Practice: attempts with a little noise on every action, kept so that what the noise did can be told from the outcome.

A policy that always does the same shows what it does, not what it should have done instead. Noise of a known size makes
it a Gaussian policy, whose success has a gradient: the sum over actions of (outcome - expected) x noise / sd x what the
network would have to change (Williams 1992, Machine Learning 8:229).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.rollout import rollout
from pipeline.simulation.world import World
from schemas.scene import SceneSpec

NOISE = 0.15
"""Standard deviation of the noise, in standard deviations of the training actions."""


@dataclass(frozen=True, slots=True)
class Practice:
    """What was seen and which noise was added, a row for every action of every attempt."""

    state: NDArray[np.float32]
    """Shape (n, 16)."""
    environment: NDArray[np.float32]
    """Shape (n, 7)."""
    noise: NDArray[np.float32]
    """Standard normal, shape (n, 5)."""
    attempt: NDArray[np.intp]
    tick: NDArray[np.intp]
    """Attempt and tick of each row; rows of an attempt rise by one tick, shape (n,) each."""
    solved: NDArray[np.bool_]
    """Of each attempt."""
    stratum: tuple[str, ...]
    """Of each attempt."""


def practise(policy: Policy, scenes: Sequence[SceneSpec], sd: NDArray[np.float32], *, seed: int,
             noise: float = NOISE) -> Practice:
    """Play scenes with noise on the actions.

    Args:
        policy: who acts.
        scenes: of the training-side simulation.
        sd: standard deviation of the training actions, shape (5,).
        seed: of the noise.
        noise: its size, in those standard deviations.
    """
    world = World(compose(load_body(scenes[0].robot), scenes[0].scene), scenes,
                  from_draws([s.draws for s in scenes]), threads=1)
    noisy = _Noisy(policy, noise * sd.astype(np.float64), np.random.default_rng([41, seed]))
    noisy.reset(world.n)
    solved = rollout(world, noisy).success
    state, environment, drawn, attempt, tick = (np.concatenate(part) for part in zip(*noisy.rows, strict=True))
    order = np.lexsort((tick, attempt))
    return Practice(state[order], environment[order], drawn[order], attempt[order], tick[order], solved,
                    tuple(s.stratum for s in scenes))


class _Noisy:
    """A policy with noise on its actions, and a record of both."""

    def __init__(self, policy: Policy, sd: Array, rng: np.random.Generator) -> None:
        self._policy, self._sd, self._rng, self._tick = policy, sd, rng, 0
        self.rows: list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], Ids, Ids]] = []

    def reset(self, n: int) -> None:
        """Prepare for n attempts."""
        self._policy.reset(n)
        self._tick, self.rows = 0, []

    def act(self, observation: Observation, ids: Ids) -> Array:
        """The policy's actions with noise."""
        action = self._policy.act(observation, ids)
        drawn = self._rng.standard_normal(action.shape).astype(np.float32)
        f32 = np.float32
        self.rows.append((observation.state.astype(f32), observation.environment.astype(f32), drawn,
                          np.asarray(ids), np.full(len(ids), self._tick)))
        self._tick += 1
        return action + drawn * self._sd

    def memory(self, ids: Ids) -> Array:
        """The policy's memory."""
        return self._policy.memory(ids)
