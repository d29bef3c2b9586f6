"""Influence scores of the episodes of a batch: what each adds to the success of the policy, by its own gradient."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.lerobot_view.training_data import TrainingData
from pipeline.worth.practice import Practice

type F32 = NDArray[np.float32]


def advantages(practice: Practice, noise: float) -> F32:
    """Outcome of each attempt minus the mean of the others of its kind of start, over noise and attempts."""
    solved, kinds = practice.solved.astype(np.float64), np.asarray(practice.stratum)
    out = np.zeros(solved.size)
    for kind in dict.fromkeys(practice.stratum):
        here = kinds == kind
        n = int(here.sum())
        out[here] = solved[here] - (solved[here].sum() - solved[here]) / max(n - 1, 1)
    return (out / (noise * solved.size)).astype(np.float32)


def by_episode(influence: NDArray[np.float64], rows: NDArray[np.intp], data: TrainingData,
               episodes: Sequence[str]) -> dict[str, float]:
    """Episode -> the sum over its samples, each weighed as often as training draws it.

    Args:
        influence: of the samples that start at `rows`.
        rows: frames of the version.
        data: the version.
        episodes: its ids in order.
    """
    weigh = np.zeros(len(data.state))
    for name, group in data.rows.items():
        weigh[group] = data.weights[name] / group.size
    total = np.bincount(np.searchsorted(data.stops, rows, "right"), influence * weigh[rows], len(episodes))
    return dict(zip(episodes, map(float, total), strict=True))
