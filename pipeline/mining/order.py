"""Order: which failures to correct first, by how many failures at work each correction is expected to end."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.mining.happened import Starts
from pipeline.protocols import Array

REACH_M = 0.08
"""How far around its start a correction teaches [m]: variants are made within 4 cm of it, and a policy generalises."""
SIZE_M = 0.003
"""Difference of height at rest that is another object [m]: three times the noise of a perceived start."""
OTHER_FAMILY = 1.0
"""What failing in another way counts as distance [reaches]."""
FOLD = 0.35
"""Starts of one family nearer than this are one and the same [reaches]: 2.8 cm."""


@dataclass(frozen=True, slots=True)
class Failures:
    """n failures of one deployment."""

    start: Starts
    """Shape (n, 3)."""
    unlike_m: Array
    """Distance of each start to the nearest that was taught [m], shape (n,)."""
    family: NDArray[np.intp]
    """Shape (n,)."""
    again: Array
    """Chance that an attempt which begins so fails, see `failing`, shape (n,)."""
    chance: Array
    """That a correction ends failures such as this one, where they are no accident, shape (n,)."""


@dataclass(frozen=True, slots=True)
class Turn:
    """One place in the queue."""

    row: int
    worth: float
    """Failures of this deployment that its correction is expected to end, beyond those before it in the queue."""
    novelty: float
    """Part of it that no correction of earlier laps reaches [1]."""
    folds: tuple[int, ...]
    """Near-duplicates that it stands for; each follows in the queue after all that stand for themselves."""


def failing(failed: Starts, solved: Starts) -> Array:
    """Share of failures among the attempts that began like each failure, weighed by a bell of REACH_M, shape (n,).

    Where a policy mostly succeeds, a failure is an accident: it knows what to do there, and a correction shows it
    nothing new.

    Args:
        failed, solved: starts of a deployment's failures and successes, shape (n, 3) and (m, 3).
    """
    against, along = (_bell(_distance(failed, s)).sum(axis=1) for s in (solved, failed))
    return along / (along + against)


def queue(failures: Failures, corrected: Starts) -> list[Turn]:
    """All failures, each followed by the one whose correction is then worth most; near-duplicates at the end.

    A correction at i ends failure j with probability again_j chance_i k_ij. k falls off with the distance of their
    starts as a bell of REACH_M; no distance is longer than the longer way from the two to what was taught, for over
    known ground a policy carries over by itself what it learns of another object or of letting go. Another
    family counts as one REACH_M more. Each failure stands for one in so many attempts at work, so that a set of
    corrections is worth the sum over failures of one minus the product of not being ended. That is submodular: taking
    the best next one is within 1 - 1/e of the best set (Nemhauser, Wolsey and Fisher 1978). Corrections of earlier laps
    count at half their chance: failing there again says that they did not do it.

    Args:
        failures: of one deployment.
        corrected: starts of corrections of earlier laps, as perceived, shape (m, 3).
    """
    reach = _reaches(failures)
    before = 1 - 0.5 * failures.chance[:, None] * _bell(_distance(failures.start, corrected))
    new = before.prod(axis=1)
    open_ = new.copy()
    folds = _folded(failures)
    turns: list[Turn] = []
    for rows in (sorted(folds), sorted(k for kept in folds.values() for k in kept)):
        left = list(rows)
        while left:
            worths = np.array([(open_ * reach[i]).sum() for i in left])
            i = left.pop(int(worths.argmax()))
            turns.append(Turn(i, float(worths.max()), float(new[i]), tuple(folds.get(i, ()))))
            open_ = open_ * (1 - reach[i])
    return turns


def _reaches(failures: Failures) -> Array:
    """Chance that a correction at i ends failure j, shape (n, n)."""
    way = np.maximum(failures.unlike_m[:, None], failures.unlike_m[None])
    other = OTHER_FAMILY * (failures.family[:, None] != failures.family[None])
    distance = np.hypot(_distance(failures.start, failures.start, way), other)
    return failures.again[None] * failures.chance[:, None] * _bell(distance)


def _distance(a: Starts, b: Starts, longest_m: Array | float = np.inf) -> Array:
    """Between starts [reaches], shape (len(a), len(b)); horizontally no more than `longest_m` [m]."""
    if not len(a) or not len(b):
        return np.zeros((len(a), len(b)))
    flat = np.minimum(np.linalg.norm(a[:, None, :2] - b[None, :, :2], axis=2), longest_m)
    return np.hypot(flat / REACH_M, (a[:, None, 2] - b[None, :, 2]) / SIZE_M)


def _bell(distance: Array) -> Array:
    return np.exp(-(distance**2) / 2)


def _folded(failures: Failures) -> dict[int, list[int]]:
    """Failures that stand for themselves -> those that they stand for; who has most neighbours stands for them."""
    close = (_distance(failures.start, failures.start) < FOLD) & (failures.family[:, None] == failures.family[None])
    left, folds = set(range(len(close))), dict[int, list[int]]()
    for i in sorted(left, key=lambda k: (-int(close[k].sum()), k)):
        if i in left:
            folds[i] = sorted(k for k in left if close[i, k] and k != i)
            left -= {i, *folds[i]}
    return folds
