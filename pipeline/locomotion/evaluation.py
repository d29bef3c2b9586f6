"""Evaluation: attempts of seeds of their own, each played once to its end, and the baselines that belong beside it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.starts import draw_start, seed_of
from pipeline.locomotion.tasks import LeggedTask
from pipeline.locomotion.trying import Act, trying
from pipeline.locomotion.world import LeggedWorld
from pipeline.protocols import Array

EVALUATION = 0x6576616C
"""Word that keeps the seeds of these starts apart from those of training."""
SETTLED_S, OFF_M_S = 2.0, 0.1
"""A robot follows its command if, from the first time on, its mean speed forward is not further off than the second."""


@dataclass(frozen=True, slots=True)
class Evaluated:
    """n attempts, each until it fell or its time was up."""

    full: NDArray[np.bool_]
    """Which reached their end, shape (n,)."""
    length: NDArray[np.int64]
    """Ticks until the fall, or all, shape (n,)."""
    terms: dict[str, float]
    """Reward term -> its weighted mean a tick, over ticks before a fall."""
    error: float
    """Mean distance between the asked and the true speed over ground, over ticks before a fall [m/s]."""
    asked: Array
    """Speed that each was asked for: forward, left [m/s], turning [rad/s]; shape (n, 3)."""
    mean: Array
    """Mean speed of each in its own heading, as `asked`, from SETTLED_S to its end; NaN where it fell before."""
    steps_hz: Array
    """How often each foot of each came down a second, over these ticks, shape (n,); a clock asks 1 / stride_s."""
    airborne: Array
    """Share of these ticks in which no foot of it pressed on the ground, shape (n,)."""

    @property
    def follows(self) -> NDArray[np.bool_]:
        """Which reached their end at the speed forward that they were asked for, shape (n,): to walk is both."""
        return self.full & (np.abs(self.mean[:, 0] - self.asked[:, 0]) <= OFF_M_S)


def evaluation_seed(seed: int, k: int) -> int:
    """Seed of the k-th start; no training meets it."""
    return seed_of(seed, k, EVALUATION)


def evaluate(act: Act, body: LeggedBody, task: LeggedTask, *, n: int = 200, seed: int = 0, stratum: str | None = None,
             threads: int = 1) -> Evaluated:
    """Play n attempts to their ends; ConfigError for a kind of start that the task does not have."""
    kind = stratum or next(iter(task.starts))
    world = LeggedWorld(body, task, n, threads=threads)
    world.restart(np.arange(n), [draw_start(task, body, kind, evaluation_seed(seed, k)) for k in range(n)])
    alive, length = np.ones(n, bool), np.zeros(n, np.int64)
    sums, error = dict.fromkeys(task.weights, 0.0), 0.0
    settled, covered = round(SETTLED_S * task.control_hz), np.zeros((n, 3))
    steps, airborne, stood = np.zeros(n), np.zeros(n), np.ones((n, len(body.feet)), bool)
    for tried in trying(act, world, task.ticks):
        now, alive = tried.now, tried.stands
        length += alive
        for name, values in world.rewards(now).items():
            sums[name] += float(values[alive].sum())
        error += float(np.linalg.norm(now.velocity[:, :2] - now.command[:, :2], axis=1)[alive].sum())
        if tried.tick >= settled:
            covered[alive] += now.velocity[alive]
            steps += alive * (now.contact & ~stood).sum(axis=1)
            airborne += alive & ~now.contact.any(axis=1)
        stood = now.contact
    ticks, counted = max(1, int(length.sum())), np.maximum(length - settled, 0)

    def mean(total: Array) -> Array:
        return total / np.where(counted > 0, counted, np.nan)

    return Evaluated(alive, length, {name: total / ticks for name, total in sums.items()}, error / ticks,
                     world.command.copy(), mean(covered.T).T, mean(steps) * task.control_hz / len(body.feet),
                     mean(airborne))


def zero_action(joints: int) -> Act:
    """Asks nothing of any joint: servos hold home, motors give their torques of rest."""
    return lambda sensed: np.zeros((len(sensed), joints))


def random_action(joints: int, seed: int) -> Act:
    """Draws every action evenly from [-1, 1]."""
    rng = np.random.default_rng([seed, EVALUATION])
    return lambda sensed: rng.uniform(-1, 1, (len(sensed), joints))
