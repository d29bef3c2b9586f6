"""Demonstrations: attempts of an expert that reached their end, as pairs of what was sensed and what was done."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import PolicyError
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.starts import draw_start, seed_of
from pipeline.locomotion.tasks import LeggedTask
from pipeline.locomotion.trying import Act, trying
from pipeline.locomotion.world import LeggedWorld
from pipeline.protocols import Array

SIDE_BY_SIDE = 128
"""Attempts that are played at once."""
THIN = 4
DEMONSTRATION = 79
"""Word that keeps these starts apart from those of training and evaluation."""
HORIZON = 3.0
"""An attempt's last ticks have no known worth: rewards after its end would count. In units of 1 / (1 - gamma)."""


@dataclass(frozen=True, slots=True)
class Demonstrations:
    """Attempts that reached their end, one after another; t ticks each."""

    sensed: NDArray[np.float32]
    """Shape (kept, t, w)."""
    action: Array
    """What the expert did, in [-1, 1], shape (kept, t, j)."""
    worth: Array
    """Sum of the rewards from a tick on, discounted; NaN near the end. Shape (kept, t)."""
    met: NDArray[np.float32]
    """What was sensed in all attempts before they fell, kept or not: every THIN-th tick, shape (m, w)."""
    played: int
    """Attempts that were played."""
    steps: int
    """Environment steps that they took, those that fell included."""


def demonstrate(act: Act, body: LeggedBody, task: LeggedTask, *, keep: int, most: int, seed: int, stratum: str,
                gamma: float = 0.98, told: Callable[[int], None] = lambda _: None) -> Demonstrations:
    """Let an expert play until enough of its attempts reached their end.

    Args:
        act: the expert.
        body, task: what is done.
        keep: full attempts that are wanted.
        most: attempts after which it gives up; what is there by then is kept.
        seed: of the starts.
        stratum: kind of start.
        gamma: worth of the next tick's reward today.
        told: called with the number of full attempts so far.

    Raises:
        PolicyError: not one attempt reached its end.
    """
    world = LeggedWorld(body, task, SIDE_BY_SIDE)
    kept: list[tuple[NDArray[np.float32], Array, Array]] = []
    met: list[NDArray[np.float32]] = []
    played = steps = 0
    while len(kept) < keep and played < most:
        starts = [draw_start(task, body, stratum, start_seed(seed, played + k)) for k in range(SIDE_BY_SIDE)]
        world.restart(np.arange(SIDE_BY_SIDE), starts)
        sensed, action, reward, stands = _play(act, world)
        worth = discounted(reward, gamma)
        kept += [(sensed[:, i], action[:, i], worth[:, i]) for i in np.flatnonzero(stands[-1])]
        met.append(sensed[::THIN][stands[::THIN]])
        played, steps = played + SIDE_BY_SIDE, steps + int(stands.sum())
        told(min(len(kept), keep))
    if not kept:
        raise PolicyError(f"the expert fell in all of {played} attempts", where=f"{stratum} starts",
                          mend="let it begin milder: another --stratum, --calm; or clone another expert")
    sensed, action, worth = (np.stack(part) for part in zip(*kept[:keep], strict=True))
    return Demonstrations(sensed, action, worth, np.concatenate(met), played, steps)


def start_seed(seed: int, k: int) -> int:
    """Seed of the k-th start of demonstrations."""
    return seed_of(seed, k, DEMONSTRATION)


def discounted(reward: Array, gamma: float) -> Array:
    """Worth of every tick, shape (t, n) -> (t, n); NaN where the end is too near to know it."""
    worth, total = np.full_like(reward, np.nan), np.zeros(reward.shape[1])
    known = len(reward) - round(HORIZON / (1 - gamma))
    for tick in range(len(reward) - 1, -1, -1):
        total = reward[tick] + gamma * total
        if tick < known:
            worth[tick] = total
    return worth


def _play(act: Act, world: LeggedWorld) -> tuple[NDArray[np.float32], Array, Array, NDArray[np.bool_]]:
    """What was sensed, done and rewarded, and who had not fallen after it; tick by tick."""
    n, ticks = world.n, world.task.ticks
    sensed = np.zeros((ticks, n, world.width), np.float32)
    action, reward = np.zeros((ticks, n, world.action_size)), np.zeros((ticks, n))
    stands = np.zeros((ticks, n), bool)
    for tried in trying(act, world, ticks):
        sensed[tried.tick], action[tried.tick], stands[tried.tick] = tried.sensed, tried.action, tried.stands
        reward[tried.tick] = np.sum(list(world.rewards(tried.now).values()), axis=0)
    return sensed, action, reward, stands
