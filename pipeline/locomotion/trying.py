"""Trying: attempts side by side, tick by tick, until every robot has fallen or the time is up."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.locomotion.rewards import Motion
from pipeline.locomotion.world import LeggedWorld
from pipeline.protocols import Array

type Act = Callable[[NDArray[np.float32]], Array]
"""What is sensed, shape (n, w) -> actions, shape (n, j)."""


@dataclass(frozen=True, slots=True)
class Tried:
    """One control period of n attempts."""

    tick: int
    sensed: NDArray[np.float32]
    """What was sensed before it, shape (n, w)."""
    action: Array
    """What was done, shape (n, j)."""
    now: Motion
    """What truly happened."""
    stands: NDArray[np.bool_]
    """Which have not fallen so far, shape (n,)."""


def trying(act: Act, world: LeggedWorld, ticks: int) -> Iterator[Tried]:
    """Let `act` drive robots that have their starts; nobody begins anew.

    Args:
        act: the policy.
        world: after its restart.
        ticks: how long at most; it ends sooner where nobody stands any more.
    """
    stands = np.ones(world.n, bool)
    for tick in range(ticks):
        sensed = world.observe()
        action = act(sensed)
        world.act(action)
        now = world.motion()
        stands = stands & ~world.fallen(now)
        yield Tried(tick, sensed, action, now, stands)
        if not stands.any():
            return
