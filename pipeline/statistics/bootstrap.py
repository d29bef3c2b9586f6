"""A statistic of attempts that were made in several seeds, with its interval over both."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.statistics.seeds import Interval

type Values = NDArray[np.float64]


def bootstrap(values: Values, statistic: Callable[[Values], Values], rng: np.random.Generator, *,
              replicates: int = 2000, level: float = 0.95) -> Interval:
    """The statistic of all attempts, with a percentile interval.

    Each replicate draws seeds with replacement and then, within each drawn seed, attempts with replacement.
    With few seeds the interval is somewhat too narrow, as that of `bootstrap_difference`.

    Args:
        values: one an attempt, shape (seeds, attempts); infinity where something never happened.
        statistic: of rows (k, m) -> (k,), such as `lambda rows: np.median(rows, axis=1)`.
        rng: source of the draws.
        replicates: number of them.
        level: coverage of the two-sided interval.

    Raises:
        ConfigError: no values, or not by seeds and attempts.

    Source: Davison and Hinkley 1997, Bootstrap Methods and their Application, section 3.8.
    """
    if values.ndim != 2 or not values.size:
        raise ConfigError(f"values of shape {values.shape}", where="bootstrap", mend="give (seeds, attempts)")
    seeds, attempts = values.shape
    seed = rng.integers(seeds, size=(replicates, seeds, 1))
    drawn = values[seed, rng.integers(attempts, size=(replicates, seeds, attempts))].reshape(replicates, -1)
    # By rank, not between ranks: infinity less infinity is no number.
    low, high = np.quantile(statistic(drawn), [(1 - level) / 2, (1 + level) / 2], method="closest_observation")
    return Interval(float(statistic(values.reshape(1, -1))[0]), float(low), float(high))


def median(rows: Values) -> Values:
    """The median of each row by rank, so that it may be infinite; the lower one of two."""
    return np.quantile(rows, 0.5, axis=1, method="inverted_cdf")


def mean(rows: Values) -> Values:
    """The mean of each row."""
    return rows.mean(axis=1)
