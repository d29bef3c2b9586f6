"""The interquartile mean of returns: of their middle half, so that one lucky or broken run moves it little."""

import numpy as np
from numpy.typing import NDArray

from pipeline.statistics.bootstrap import bootstrap
from pipeline.statistics.seeds import Interval

type Returns = NDArray[np.float64]

CUT = 0.25
"""Share that is left out at either end."""


def interquartile_mean(rows: Returns) -> Returns:
    """Mean of the middle half of each row, (k, m) -> (k,); as scipy.stats.trim_mean with 0.25 has it."""
    cut = int(CUT * rows.shape[1])
    return np.asarray(np.sort(rows, axis=1)[:, cut:rows.shape[1] - cut].mean(axis=1), np.float64)


def bootstrap_interquartile(returns: Returns, rng: np.random.Generator, *, replicates: int = 4000,
                            level: float = 0.95) -> Interval:
    """Interquartile mean over seeds and episodes, with a percentile interval; seeds are drawn, then their episodes.

    Seeds are few: one draw of nine of three seeds is three times the same one, so that the interval says hardly more
    than from the worst seed to the best.

    Args:
        returns: shape (seeds, episodes).
        rng: source of the draws; the same state gives the same interval.
        replicates: number of bootstrap replicates.
        level: nominal coverage of the two-sided interval.

    Raises:
        ConfigError: no seed or no episode, or another shape.

    Source: Agarwal et al. 2021, Deep Reinforcement Learning at the Edge of the Statistical Precipice, arXiv 2108.13264.
    """
    return bootstrap(returns, interquartile_mean, rng, replicates=replicates, level=level)
