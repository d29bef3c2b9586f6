"""The interquartile mean of returns: of their middle half, so that one lucky or broken run moves it little."""

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.statistics.seeds import Interval

type Returns = NDArray[np.float64]

CUT = 0.25
"""Share that is left out at either end."""


def interquartile_mean(returns: Returns) -> float:
    """Mean of the middle half of all values, whatever the shape; as scipy.stats.trim_mean with 0.25 has it."""
    ordered, cut = np.sort(returns, axis=None), int(CUT * returns.size)
    return float(ordered[cut:returns.size - cut].mean())


def bootstrap_interquartile(returns: Returns, rng: np.random.Generator, *, replicates: int = 4000,
                            level: float = 0.95) -> Interval:
    """Interquartile mean over seeds and episodes, with a percentile interval.

    Each replicate draws seeds with replacement and then, within each drawn seed, episodes with replacement. Seeds are
    few: three of them give ten different draws, one of which is wholly one seed in one draw of nine, so that the
    interval hardly says more than from the worst seed to the best.

    Args:
        returns: shape (seeds, episodes).
        rng: source of the draws; the same state gives the same interval.
        replicates: number of bootstrap replicates.
        level: nominal coverage of the two-sided interval.

    Raises:
        ConfigError: no seed or no episode, or another shape.

    Source: Agarwal et al. 2021, Deep Reinforcement Learning at the Edge of the Statistical Precipice, arXiv 2108.13264;
    drawing seeds, then episodes: Davison and Hinkley 1997, section 3.8.
    """
    if returns.ndim != 2 or not returns.size:
        raise ConfigError(f"returns of shape {returns.shape}", where="interquartile mean",
                          mend="hand in one row for each seed, one column for each episode")
    seeds, episodes = returns.shape
    found = np.empty(replicates)
    for k in range(replicates):
        drawn = rng.integers(seeds, size=seeds)[:, None]
        found[k] = interquartile_mean(returns[drawn, rng.integers(episodes, size=(seeds, episodes))])
    low, high = np.quantile(found, [(1 - level) / 2, (1 + level) / 2])
    return Interval(estimate=interquartile_mean(returns), low=float(low), high=float(high))
