"""Rollout: drive robots with a policy until every attempt has ended; finished ones leave the Batch."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.simulation.tracing import Tracer


class Task(Protocol):
    """What an attempt at any task has."""

    @property
    def ticks(self) -> int:
        """Longest attempt [ticks]."""
        ...

    @property
    def weights(self) -> Mapping[str, float]:
        """Reward term -> its weight."""
        ...


class Playing(Protocol):
    """n simulated robots side by side: a World, or LeggedRobots."""

    n: int

    @property
    def task(self) -> Task:
        """What they are to do."""
        ...

    def observe(self, ids: Ids) -> Observation:
        """What they perceive now."""
        ...

    def act(self, action: Array, ids: Ids) -> None:
        """Send actions and let one control period pass."""
        ...

    def succeeded(self, ids: Ids) -> NDArray[np.bool_]:
        """Truth, shape (len(ids),)."""
        ...

    def rewards(self, ids: Ids) -> dict[str, Array]:
        """Reward terms of the tick just passed, each (len(ids),)."""
        ...


type Watch = Callable[[int, Ids, Observation, Array], NDArray[np.bool_]]
"""(tick, ids, observation, action sent) -> attempts that end now, shape (len(ids),)."""


@dataclass(frozen=True, slots=True)
class Result:
    """How n attempts ended."""

    success: NDArray[np.bool_]
    """Truth, shape (n,)."""
    ticks: NDArray[np.int64]
    """Length of each attempt, shape (n,)."""
    rewards: dict[str, Array]
    """Reward term -> mean over the attempts still running at each tick, shape (horizon,)."""


def rollout(world: Playing, policy: Policy, *, ids: Ids | None = None, horizon: int | None = None,
            watch: Watch | None = None, tracer: Tracer | None = None, until_success: bool = True,
            with_rewards: bool = False) -> Result:
    """Run every attempt to its end.

    Args:
        world: attempts at their start, or restored.
        policy: acts on observations; the caller has reset it, or restored its memory.
        ids: the attempts to run; all where None.
        horizon: longest attempt [ticks]; the task's own where None.
        watch: called every tick after acting; may end attempts.
        tracer: keeps everything that a recording holds.
        until_success: attempts end once the truth says success.
        with_rewards: collect reward curves.
    """
    horizon = min(horizon or world.task.ticks, world.task.ticks)
    ids = np.arange(world.n) if ids is None else ids
    ticks, curves = np.zeros(world.n, np.int64), {name: np.full(horizon, np.nan) for name in world.task.weights}
    for tick in range(horizon):
        observation = world.observe(ids)
        action = policy.act(observation, ids)
        if tracer is not None:
            tracer.before(ids, observation, action, policy)
        world.act(action, ids)
        if tracer is not None:
            tracer.after(ids)
        ticks[ids] = tick + 1
        if with_rewards:
            for name, value in world.rewards(ids).items():
                curves[name][tick] = value.mean()
        over = world.succeeded(ids) if until_success else np.zeros(len(ids), bool)
        if watch is not None:
            over = over | watch(tick, ids, observation, action)
        ids = ids[~over]
        if not len(ids):
            break
    return Result(world.succeeded(np.arange(world.n)), ticks, curves if with_rewards else {})
