"""Whole runs as the unit: the training seed alone moves a result by many points, so claims are pooled over seeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.statistics.paired import mcnemar

type Runs = NDArray[np.bool_]
type Rates = NDArray[np.float64]
type Counts = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate between its limits."""

    estimate: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class SignTest:
    """In how many seeds one arm was ahead; seeds without a difference count for neither."""

    wins: int
    losses: int
    p_one_sided: float
    """Against the first arm being ahead; 3 of 3 give 0.125, 8 of 8 give 0.004."""
    p_two_sided: float


def bootstrap_difference(strata: Mapping[str, tuple[Runs, Runs]], shares: Mapping[str, float],
                         rng: np.random.Generator, *, replicates: int = 10_000, level: float = 0.95) -> Interval:
    """Success of the first arm minus that of the second, pooled over seeds, with a percentile interval.

    Each replicate draws seeds with replacement and then, within each drawn seed and stratum, scenes with
    replacement; a scene keeps both its outcomes. Resampling n scenes whose differences are +1, 0 or -1 is the same
    as one multinomial draw of their counts, which is how it is done: time does not grow with the scenes.
    With few seeds the interval is somewhat too narrow (docs/decisions/006-gate.md has the measured coverage).

    Args:
        strata: stratum -> outcomes of the two arms on the same scenes, each of shape (seeds, scenes).
        shares: stratum -> weight, summing to 1: {"all": 1.0}, or the deployment mix.
        rng: source of the draws; the same state gives the same interval.
        replicates: number of bootstrap replicates.
        level: coverage of the two-sided interval.

    Raises:
        ConfigError: shapes differ between arms, seeds differ between strata, or shares do not match the strata.

    Source: Davison and Hinkley 1997, Bootstrap Methods and their Application, section 3.8; Ren et al. 2010,
    J. Applied Statistics 37:1487.
    """
    _check(strata, shares)
    seeds = next(iter(strata.values()))[0].shape[0]
    drawn = rng.integers(seeds, size=(replicates, seeds))
    estimate, replicate = 0.0, np.zeros(replicates)
    for name, (first, second) in strata.items():
        n = first.shape[1]
        ahead: Rates = np.mean(first & ~second, axis=1)
        behind: Rates = np.mean(second & ~first, axis=1)
        estimate += shares[name] * float((ahead - behind).mean())
        up: Counts = rng.binomial(n, ahead[drawn])
        rest: Rates = np.clip(behind / np.maximum(1 - ahead, 1e-300), 0, 1)
        down: Counts = rng.binomial(n - up, rest[drawn])
        replicate += shares[name] * ((up - down) / n).mean(axis=1)
    low, high = np.quantile(replicate, [(1 - level) / 2, (1 + level) / 2])
    return Interval(estimate=estimate, low=float(low), high=float(high))


def sign_test(differences: Sequence[float]) -> SignTest:
    """Exact sign test over seeds: under equal arms each seed favours either like a fair coin.

    Args:
        differences: first arm minus second, one number a seed; zeros count for neither.

    Source: Conover 1999, Practical Nonparametric Statistics, section 3.4.
    """
    wins, losses = sum(d > 0 for d in differences), sum(d < 0 for d in differences)
    test = mcnemar(wins, losses)
    return SignTest(wins=wins, losses=losses, p_one_sided=test.p_gain, p_two_sided=test.p_two_sided)


def _check(strata: Mapping[str, tuple[Runs, Runs]], shares: Mapping[str, float]) -> None:
    """Refuse arms that are not paired, and shares that are not of these strata."""
    shapes = {name: (first.shape, second.shape) for name, (first, second) in strata.items()}
    seeds = {shape[0] for pair in shapes.values() for shape in pair if len(shape) == 2 and 0 not in shape}
    if any(a != b or len(a) != 2 or 0 in a for a, b in shapes.values()) or len(seeds) != 1:
        raise ConfigError(f"outcomes of shapes {shapes} are not paired by seed and scene", where="bootstrap",
                          mend="give both arms as (seeds, scenes), the same seeds in every stratum")
    if set(shares) != set(strata) or abs(sum(shares.values()) - 1) > 1e-9:
        raise ConfigError(f"shares {dict(shares)} do not fit strata {sorted(strata)}", where="bootstrap",
                          mend="give each stratum its share; the shares sum to 1")
