"""Attempts: many legged robots that begin anew as soon as they have fallen or their time is up; what PPO learns in."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.locomotion import varied
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.starts import Start, draw_start, seed_of
from pipeline.locomotion.tasks import LeggedTask
from pipeline.locomotion.world import LeggedWorld
from pipeline.protocols import Array, Ids


@dataclass(frozen=True, slots=True)
class Tick:
    """What one control period brought."""

    observation: NDArray[np.float32]
    """What the robots sense now; of those that began anew, their start. Shape (n, w)."""
    reward: Array
    """Shape (n,)."""
    terms: Mapping[str, Array]
    """Reward term -> its weighted value, shape (n,)."""
    fallen: NDArray[np.bool_]
    """Which attempts ended in a fall, shape (n,)."""
    late: NDArray[np.bool_]
    """Which ended because their time was up, shape (n,)."""
    last: NDArray[np.float32]
    """Of attempts that ended: what was sensed last; rows as `ended`."""
    ended: Ids
    """Attempts that ended and began anew."""
    length: NDArray[np.int64]
    """Their lengths [ticks]."""


class Attempts:
    """n attempts side by side; the k-th start in place i follows from the seed, i and k.

    Args:
        body, task: what is done.
        n: how many.
        seed: of the starts.
        stratum: kind of start; the first of the task where None.
        draw: how a start follows from its seed, in place of a kind of start.
        vary: how much the robots differ, each place having one of its own; 0: all are the nominal one.
        threads: threads of the engine.
    """

    def __init__(self, body: LeggedBody, task: LeggedTask, n: int, *, seed: int, stratum: str | None = None,
                 draw: Callable[[int], Start] | None = None, vary: float = 0.0, threads: int = 1) -> None:
        self.world, self.task, self.body = _world(body, task, n, seed, vary, threads), task, body
        self.seed, self._stratum, self._draw = seed, stratum or next(iter(task.starts)), draw
        self.begun = np.zeros(n, np.int64)
        """Attempts begun in each place so far."""
        self._all = np.arange(n)

    def begin(self) -> NDArray[np.float32]:
        """Every attempt anew; returns what is sensed."""
        self._restart(self._all)
        return self.world.observe()

    def step(self, action: Array) -> Tick:
        """One control period; who has ended begins anew."""
        world = self.world
        world.act(action)
        now = world.motion()
        terms = world.rewards(now)
        reward = np.sum(list(terms.values()), axis=0)
        fallen = world.fallen(now)
        late = ~fallen & (world.ticks >= self.task.ticks)
        observation = world.observe()
        ended = np.flatnonzero(fallen | late)
        last, length = observation[ended], world.ticks[ended]
        if len(ended):
            self._restart(ended)
            observation[ended] = world.observe()[ended]
        return Tick(observation, reward, terms, fallen, late, last, ended, length)

    def _restart(self, ids: Ids) -> None:
        self.world.restart(ids, [self.start(int(i), int(self.begun[i])) for i in ids])
        self.begun[ids] += 1

    def start(self, place: int, k: int) -> Start:
        """The k-th start in a place."""
        seed = start_seed(self.seed, place, k)
        return self._draw(seed) if self._draw else draw_start(self.task, self.body, self._stratum, seed)

    def save(self) -> dict[str, NDArray[np.float64]]:
        """All that a restart from this very moment needs."""
        return {**self.world.save(), "begun": self.begun.astype(np.float64)}

    def load(self, saved: Mapping[str, NDArray[np.float64]]) -> None:
        """Go on from what `save` gave, bit for bit."""
        self.world.load(saved)
        self.begun[:] = saved["begun"]


def _world(body: LeggedBody, task: LeggedTask, n: int, seed: int, vary: float, threads: int) -> LeggedWorld:
    if not vary:
        return LeggedWorld(body, task, n, threads=threads)
    draws = [varied.vary(np.random.default_rng([seed, place, 79]), vary) for place in range(n)]
    return varied.VariedWorld(body, task, draws, seed=seed, threads=threads)


def start_seed(seed: int, place: int, k: int) -> int:
    """Seed of the k-th start in a place: no two of one run share it."""
    return seed_of(seed, place, k, 67)
