"""Families: failures that went alike, found by what happened and not by the trigger that noticed it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]
from scipy.spatial.distance import squareform  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from pipeline.protocols import Array

CUT = 2.5
"""Mean distance beyond which two groups stay two families; the radius of a family [scales of a feature].

Chosen on twins 0-5, where it told causes apart best: see `hardcase measure families`."""
MOST = 2.0
"""No feature alone moves two attempts further apart than this [scales]: one odd number makes no family."""


@dataclass(frozen=True, slots=True)
class Joined:
    """Which family each attempt belongs to."""

    family: NDArray[np.intp]
    """Index of its family: the known ones first, in their order, then the new ones, shape (n,)."""
    medoids: tuple[int, ...]
    """Row of each new family's medoid, in the order of the families."""


def apart(a: Array, b: Array) -> Array:
    """Distances between attempts: root of summed squares, no feature counting more than MOST, shape (len(a), len(b)).

    A feature that is NaN on one side counts as equal.

    Args:
        a, b: attempts as pipeline.mining.happened.described tells them, shape (n, k) and (m, k).
    """
    return np.sqrt((np.minimum(np.nan_to_num(np.abs(a[:, None] - b[None])), MOST) ** 2).sum(axis=2))


def join(points: Array, known: Array) -> Joined:
    """Put every attempt into the nearest family that it lies within; what is left makes families of its own.

    New families: average linkage, cut at CUT (Sokal and Michener 1958); their medoid is the member with the smallest
    summed distance to the others, the first of equals. Known families keep their medoid, so that their name and what
    is known of them holds from one lap to the next.

    Args:
        points: attempts, shape (n, k).
        known: medoids of the known families, shape (f, k); f may be 0.
    """
    family = np.full(len(points), -1)
    if len(known) and len(points):
        distance = apart(points, known)
        near = distance.min(axis=1) <= CUT
        family[near] = distance.argmin(axis=1)[near]
    left = np.flatnonzero(family < 0)
    groups = grouped(points[left])
    medoids: list[int] = []
    for group in groups:
        rows = left[group]
        family[rows] = len(known) + len(medoids)
        medoids.append(int(rows[apart(points[rows], points[rows]).sum(axis=1).argmin()]))
    return Joined(family, tuple(medoids))


def grouped(points: Array) -> list[NDArray[np.intp]]:
    """Rows of each group, the largest first, the one with the first row of equals; nothing in it is drawn by chance."""
    if len(points) < 2:
        return [np.arange(len(points))] if len(points) else []
    tree: Array = linkage(squareform(apart(points, points), checks=False), "average")  # pyright: ignore[reportUnknownVariableType]
    labels = np.asarray(fcluster(tree, CUT, "distance"), np.intp)
    groups = [np.flatnonzero(labels == name) for name in np.unique(labels)]
    return sorted(groups, key=lambda rows: (-len(rows), int(rows[0])))


def agreement(found: Sequence[object], truth: Sequence[object]) -> float:
    """Adjusted Rand index of two ways to group the same things: 1 where they agree, 0 on average for chance.

    Source: Hubert and Arabie, "Comparing partitions", Journal of Classification 2 (1985), equation 5.
    """
    a, b = (np.unique(np.array([str(name) for name in names]), return_inverse=True)[1] for names in (found, truth))
    table = np.zeros((a.max() + 1, b.max() + 1))
    np.add.at(table, (a, b), 1)
    both, rows, columns = (_pairs(counts) for counts in (table, table.sum(axis=1), table.sum(axis=0)))
    expected, most = rows * columns / _pairs(np.array([len(a)])), (rows + columns) / 2
    return 1.0 if most == expected else float((both - expected) / (most - expected))


def _pairs(counts: Array) -> float:
    return float((counts * (counts - 1) / 2).sum())
