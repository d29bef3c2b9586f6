"""STEP, for comparison: the sequential test of two success rates that robot learners use, from its description.

It does not know which outcomes belong to one scene, it plans a largest number of scenes beforehand, and within that
plan it stops about as early as an unpaired test can.
"""

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from pipeline.errors import ConfigError

type Grid = NDArray[np.float64]

SPARE = 3
"""Semi-diagonals of states offered to the linear program beyond those that the risk could pay for."""


@dataclass(frozen=True, slots=True)
class StepPolicy:
    """When STEP rejects "the candidate is no better"."""

    every: int
    """Scenes between decisions."""
    reject: tuple[Grid, ...]
    """Chance of rejecting in each state (successes of the champion, of the candidate), a grid for each decision."""


@dataclass(frozen=True, slots=True)
class Operating:
    """How a test behaves at one truth, exactly."""

    rejects: float
    """Chance that it says the candidate is better."""
    scenes: float
    """Scenes it plays on average, ending at its largest number."""


def synthesize(most: int, alpha: float, *, every: int = 10, points: int = 17) -> StepPolicy:
    """Plan the test: at each decision the most states are rejected that the risk so far can pay for.

    The risk may grow in proportion to the scenes, up to alpha. At each decision a linear program maximises the summed
    chance of rejecting over states, while at each control point p, both rates being p, the risk stays within what
    may be spent by then; mirrored states (i, j) and (t - j, t - i) are treated alike. States are offered in the order
    of Barnard's statistic, largest difference first. Between control points the error may be a little above alpha.

    Args:
        most: largest number of scenes.
        alpha: error.
        every: scenes between decisions; the authors' own decides after each.
        points: about as many control points in (0, 1/2]; their mirror images come along.

    Raises:
        ConfigError: no whole number of decisions, or alpha outside (0, 0.5).

    Source: Snyder and others 2025, Is Your Imitation Learning Policy Better than Mine? Policy Comparison with
    Near-Optimal Stopping, RSS, arXiv 2503.10966; Barnard 1947, Biometrika 34:123. The code is our own.
    """
    if most < every or most % every or not 0 < alpha < 0.5:
        raise ConfigError(f"{most} scenes with a decision after every {every}, at alpha {alpha}", where="STEP",
                          mend="give a largest number that is a multiple of `every`, and an alpha in (0, 0.5)")
    rates = _control_points(most, points)
    kernel = np.stack([rates * (1 - rates), rates * (1 - rates), rates**2, (1 - rates) ** 2], axis=1)
    state, risk, reject = np.ones((rates.size, 1, 1)), np.zeros(rates.size), list[Grid]()
    for t in range(1, most + 1):
        state = _next(state, kernel)
        if t % every == 0:
            chosen = _choose(state, alpha * t / most - risk, t)
            risk += (state * chosen).sum(axis=(1, 2))
            state = state * (1 - chosen)
            reject.append(chosen)
    return StepPolicy(every, tuple(reject))


def operate(policy: StepPolicy, fixed: float, broken: float, both: float) -> Operating:
    """What the test does where a scene is solved by the candidate alone, the champion alone, or both, exactly."""
    kernel = np.array([[fixed, broken, both, 1 - fixed - broken - both]])
    state, rejects, scenes = np.ones((1, 1, 1)), 0.0, 0.0
    for t in range(1, policy.every * len(policy.reject) + 1):
        scenes += float(state.sum())
        state = _next(state, kernel)
        if t % policy.every == 0:
            chosen = policy.reject[t // policy.every - 1]
            rejects += float((state * chosen).sum())
            state = state * (1 - chosen)
    return Operating(rejects, scenes)


def _control_points(most: int, points: int) -> Grid:
    """Rates from 1 / most to 1/2: half even in log odds, dense near 0, half in arcsin sqrt, dense at 1/2."""
    odds: Grid = 1 / (1 + np.geomspace(most - 1, 1, points // 2 + 1))
    angles: Grid = np.linspace(math.asin(math.sqrt(1 / most)), math.pi / 4, points - points // 2 + 1, dtype=np.float64)
    arcs: Grid = np.sin(angles) ** 2
    return np.unique(np.round(np.concatenate([odds, arcs]), 9))


def _next(state: Grid, kernel: Grid) -> Grid:
    """One more scene: chances of each (champion, candidate) count, by control point."""
    up, left, diagonal, stay = (kernel[:, k, None, None] for k in range(4))
    size = state.shape[1]
    grown = np.zeros((state.shape[0], size + 1, size + 1))
    grown[:, :size, :size] = stay * state
    grown[:, :size, 1:] += up * state
    grown[:, 1:, :size] += left * state
    grown[:, 1:, 1:] += diagonal * state
    return grown


def _choose(state: Grid, spendable: Grid, t: int) -> Grid:
    """Chance of rejecting in each state at one decision."""
    champion, candidate = np.nonzero(np.triu(np.ones((t + 1, t + 1)), 1))
    keep = champion + candidate <= t  # the other half is its mirror image
    i, j = champion[keep], candidate[keep]
    own, alone = i + j != t, (i + j == t)
    pooled = (i + j) / (2 * t)
    order = np.argsort(-(j - i) / np.sqrt(pooled * (1 - pooled)), kind="stable")
    i, j, own, alone = i[order], j[order], own[order], alone[order]
    mass = state[:, i, j] + np.where(own, state[:, t - j, t - i], 0.0)
    chosen = np.zeros((t + 1, t + 1))
    over = (np.cumsum(mass, axis=1) > spendable[:, None]).all(axis=0)
    first = int(over.argmax()) if over.any() else i.size
    stop = min(i.size, first + 1 + SPARE * (t - int(j[min(first, i.size - 1)] - i[min(first, i.size - 1)])))
    weights = np.ones(stop)
    weighty = np.flatnonzero(mass[:, :stop].max(axis=0) > 1e-9 * max(float(spendable.max()), 1e-30))
    free = mass[:, :stop].sum(axis=1) - mass[:, weighty].sum(axis=1)
    if weighty.size:
        room = np.maximum(spendable - free, 0.0)
        weights[weighty] = _most(mass[:, weighty], room, np.where(alone[weighty], 1.0, 2.0))
    chosen[i[:stop], j[:stop]] = weights
    chosen[t - j[:stop], t - i[:stop]] = weights
    return chosen


def _most(mass: Grid, room: Grid, worth: Grid) -> Grid:
    """Weights in [0, 1] of the largest summed worth whose mass fits into the room at every control point."""
    scale = 1 / max(float(room.max()), 1e-300)
    solved = linprog(-worth, mass * scale, room * scale, bounds=(0, 1), method="highs")
    found = cast(Grid | None, getattr(solved, "x", None))
    return np.zeros_like(worth) if found is None else np.clip(found, 0, 1)
