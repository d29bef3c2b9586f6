"""Sampling: which disagreements are judged where not all can be, and how many each of them stands for."""

from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.counterfactual.windows import Window
from pipeline.protocols import Array
from schemas.counterfactual import JudgeConfig

FLOOR = 0.5
"""Added to each size, in mean sizes: what looks harmless is judged, too, now and then."""


def sample(windows: Sequence[Window | None], config: JudgeConfig) -> Mapping[int, float]:
    """Choose at most `most` attempts, large and lasting disagreements more often.

    The chance pi of an attempt is proportional to the area of its window (mean disagreement times ticks, with a
    floor) and at most 1, drawn systematically over a random order, so that exactly `most` are chosen. Each stands
    for 1 / pi attempts (Horvitz and Thompson), so that the choice tilts no mean.

    Args:
        windows: the first lasting disagreement of each attempt, if there is one.
        config: `most` and the seed.

    Returns:
        Index of each chosen attempt -> how many it stands for, in the order of the attempts.

    Source: Horvitz and Thompson 1952, JASA 47:663; Madow 1949, Annals of Mathematical Statistics 20:333.
    """
    there = [(i, w.disagreement * (w.stop - w.start)) for i, w in enumerate(windows) if w is not None]
    if config.most is None or len(there) <= config.most:
        return {i: 1.0 for i, _ in there}
    areas = np.array([area for _, area in there])
    chances = _chances(areas / areas.mean() + FLOOR, config.most)
    rng = np.random.default_rng([config.seed, 17])
    order = rng.permutation(len(there))
    passed = np.floor(np.cumsum(chances[order]) + rng.random() + 1e-9)
    drawn = order[np.diff(passed, prepend=0.0) > 0]
    return {there[k][0]: float(1 / chances[k]) for k in sorted(drawn.tolist())}


def _chances(sizes: Array, count: int) -> Array:
    """Chances proportional to sizes, at most 1, that sum to `count`."""
    sure = np.zeros(len(sizes), bool)
    while True:
        chances = np.where(sure, 1.0, 0.0)
        chances[~sure] = (count - sure.sum()) * sizes[~sure] / sizes[~sure].sum()
        over = ~sure & (chances > 1)
        if not over.any():
            return chances
        sure |= over
