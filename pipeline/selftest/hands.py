"""A hand that works like a person's: it stops now and then, and sometimes reaches beside."""

import numpy as np

from pipeline.protocols import Array, Ids, Observation
from pipeline.simulation.expert import Expert

PAUSE_TICKS = (8, 25)
"""How long it stands still [ticks of 0.05 s]: shorter than what counts as a stall."""
PAUSE_FROM = 40
"""A pause begins before this tick."""
BESIDE_M = (0.025, 0.045)
"""How far beside the object it reaches [m]: the fingers close on nothing."""
BESIDE_SHARE = 0.5
"""Share of attempts that reach beside."""


class Hesitant:
    """Implements pipeline.protocols.Policy: the scripted expert, with pauses and misses drawn by seed."""

    def __init__(self, seed: int) -> None:
        self._expert, self._seed = Expert(), seed

    def reset(self, n: int) -> None:
        """Draw every attempt's pause and aim anew."""
        rng = np.random.default_rng([0x5E1F, self._seed])
        self._expert.reset(n)
        self._tick = np.zeros(n, int)
        self._pause_at, self._pause_for = rng.integers(5, PAUSE_FROM, n), rng.integers(*PAUSE_TICKS, n)
        far, angle = rng.uniform(*BESIDE_M, n), rng.uniform(0, 2 * np.pi, n)
        misses = rng.random(n) < BESIDE_SHARE
        self._beside: Array = np.column_stack([np.cos(angle), np.sin(angle)]) * np.where(misses, far, 0.0)[:, None]

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Actions (len(ids), 5) in the order of ids."""
        seen = observation.environment.copy()
        seen[:, :2] += self._beside[ids]
        action = self._expert.act(Observation(observation.state, seen), ids)
        since = self._tick[ids] - self._pause_at[ids]
        paused = (since >= 0) & (since < self._pause_for[ids])
        action[paused, :4], action[paused, 4] = 0.0, observation.state[paused, 15]
        self._tick[ids] += 1
        return action

    def memory(self, ids: Ids) -> Array:
        """Ticks so far and the expert's offsets, shape (len(ids), 4)."""
        return np.column_stack([self._tick[ids], self._expert.memory(ids)])
