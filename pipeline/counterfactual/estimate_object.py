"""Object: where the log says that the object was, at the latest tick at which that can be told well."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.counterfactual.estimate_eyes import Eyes, across, holding
from pipeline.counterfactual.estimate_log import ASKED, CLOSING_M, OPENING, TOOL, TOOL_YAW, SensedLog
from pipeline.protocols import Array

BEFORE = 8
"""Ticks before the moment at which a replay begins, at least, where the object can be told [ticks]."""
STILL_M = 0.004
"""What lies still is not perceived to move by more than this from two ticks to the next two [m]."""
CLEAR_M = 0.006
"""Open fingers touch nothing if they are this much wider than the object [m]."""
FEW = 3
"""Ticks for which an object has to be held before it sits [ticks]."""


@dataclass(frozen=True, slots=True)
class Told:
    """Where an object is believed to be at a tick; perception's bias is still in it."""

    tick: int
    held: bool
    cube: Array
    """Mean of what was perceived, x, y, z [m], yaw [rad], as the tool stands at the tick."""
    ticks: int
    """How many ticks it is a mean of."""

    def draw(self, log: SensedLog, biases: Array, eyes: Eyes, middle_m: float, rng: np.random.Generator) -> Array:
        """Where the object may be in truth, one row a bias, shape (len(biases), 4)."""
        sd = eyes.noise / np.sqrt(self.ticks)
        cubes = np.tile(self.cube, (len(biases), 1))
        cubes[:, :2] += rng.normal(0, sd, biases.shape) - biases
        if self.held:
            normal, tool = across(log.state[self.tick, TOOL_YAW]), log.state[self.tick, TOOL][:2]
            cubes[:, :2] += np.outer(middle_m - (cubes[:, :2] - tool) @ normal, normal)
        return cubes


def told(log: SensedLog, tick: int, half_m: float) -> Told:
    """Where to begin the replay that leads to a tick.

    That is where the object has lain still untouched or has sat between the fingers for a while, at least BEFORE
    ticks earlier if there is such a tick, else as late as possible; the start of the attempt always is one.

    Args:
        log: of the attempt.
        tick: the moment.
        half_m: half edge of the object [m].
    """
    held, lies = _sits(log, half_m), _lies(log, half_m)
    clear = np.flatnonzero((held | lies)[:tick + 1])
    early = clear[clear <= max(0, tick - BEFORE)]
    start = int((early if early.size else clear)[-1])
    if held[start]:
        return _in_hand(log, start, _run(held, start, tick))
    near = np.linalg.norm(log.environment[:, :2] - log.environment[start, :2], axis=1) < 3 * STILL_M
    rows = _run(lies & near, start, tick)
    mean = np.append(log.environment[rows, :3].mean(axis=0), log.environment[start, 3])
    if abs(mean[2] - half_m) < CLEAR_M:
        mean[2] = half_m
    return Told(start, False, mean, rows.size)


def _sits(log: SensedLog, half_m: float) -> NDArray[np.bool_]:
    held = holding(log, half_m)
    return np.array([held[max(0, k - FEW + 1):k + 1].all() and k + 1 >= FEW for k in range(len(log))])


def _lies(log: SensedLog, half_m: float) -> NDArray[np.bool_]:
    """Ticks at which nothing touches the object and it does not move, shape (m,); the first always is one."""
    seen = log.environment[:, :3]
    open_ = (log.state[:, ASKED] > CLOSING_M) & (log.state[:, OPENING] > 2 * half_m + CLEAR_M)
    still = np.ones(len(log), bool)
    for k in range(3, len(log)):
        still[k] = np.linalg.norm(seen[k - 1:k + 1].mean(axis=0) - seen[k - 3:k - 1].mean(axis=0)) < STILL_M
    low = np.abs(seen[:, 2] - half_m) < 2 * CLEAR_M
    lies = open_ & still & low
    lies[0] = True
    return lies


def _run(mask: NDArray[np.bool_], start: int, stop: int) -> NDArray[np.intp]:
    """Ticks of the unbroken stretch around `start`, none beyond `stop`."""
    wrong = np.flatnonzero(~mask)
    before, after = wrong[wrong < start], wrong[wrong > start]
    return np.arange(before[-1] + 1 if before.size else 0, min(after[0] if after.size else len(mask), stop + 1))


def _in_hand(log: SensedLog, start: int, rows: NDArray[np.intp]) -> Told:
    """What is held keeps its place in the hand: the mean over the whole grasp, as the tool stands at the tick."""
    gap = log.environment[rows, :3] - log.state[rows][:, TOOL]
    turn = log.state[start, TOOL_YAW] - log.state[rows, TOOL_YAW]
    cos, sin = np.cos(turn), np.sin(turn)
    level = np.stack([cos * gap[:, 0] - sin * gap[:, 1], sin * gap[:, 0] + cos * gap[:, 1], gap[:, 2]], axis=1)
    place = log.state[start, TOOL] + level.mean(axis=0)
    return Told(start, True, np.append(place, log.environment[start, 3]), rows.size)
