"""Change: what a promotion would do to success at work, from what was judged at disagreements.

Let t be the first tick of an attempt at which candidate and champion begin to disagree for a while. Up to t both act
nearly alike, so the candidate alone would have come to nearly the same moment; from t on it is run alone. Its success
from there, minus the champion's from there, is what the promotion changes in this attempt; where no disagreement
lasts, it changes nothing. The mean over the attempts is the expected change. It is exact where both act alike before
t, whatever the candidate does afterwards, since t is decided by what was seen up to t and by nothing later.

That they act only nearly alike is an assumption, and it is measured: some attempts are judged from their first tick,
too, where nothing has to be assumed, and the difference is told with its interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.errors import ConfigError
from pipeline.protocols import Array
from pipeline.statistics import Interval

REPLICATES = 4000


@dataclass(frozen=True, slots=True)
class Sampled:
    """Gains of a random sample of those attempts of a group in which the policies part."""

    attempts: int
    """Attempts of the group."""
    apart: int
    """Those with a lasting disagreement."""
    gains: Sequence[float]
    """Candidate's success minus the champion's from the moment on, in [-1, 1], of those that were judged."""
    weights: Sequence[float] = ()
    """How many of those apart each judged one stands for; all alike where none are given."""


def expected_change(sampled: Sampled, rng: np.random.Generator, *, level: float = 0.95) -> Interval:
    """Mean change of success an attempt, with a bootstrap interval over attempts.

    change = apart / attempts x mean(gains), weighted where not all had the same chance to be judged. Each replicate
    draws how many attempts are apart, and as many of the judged ones as there are, with replacement. Half an attempt
    that gains everything and half an one that loses everything are added for the interval alone (Agresti and Min's
    half in every cell of a paired table), or a hundred attempts without a disagreement would be taken for proof
    that there never is one.

    Args:
        sampled: what was judged.
        rng: source of the draws.
        level: coverage of the two-sided interval.

    Raises:
        ConfigError: no attempts, more of them apart than there are, or some apart and none judged.

    Source: Davison and Hinkley 1997, Bootstrap Methods, section 3.7 (two-phase samples); Agresti and Min 2005,
    Statistics in Medicine 24:729.
    """
    n, apart, gains = sampled.attempts, sampled.apart, np.asarray(sampled.gains, np.float64)
    if n < 1 or apart > n or (apart and not gains.size):
        raise ConfigError(f"{gains.size} judged of {apart} disagreements in {n} attempts", where="expected change",
                          mend="judge at least one disagreement: raise --most, or see why all were refused")
    own = np.asarray(sampled.weights, np.float64) if len(sampled.weights) else np.ones(gains.size)
    estimate = apart / n * float(np.average(gains, weights=own)) if gains.size else 0.0
    pool = np.concatenate([gains, [1.0, -1.0]])
    heavy = np.concatenate([own / own.mean() if gains.size else own, [1.0, 1.0]])
    chance = np.concatenate([np.full(gains.size, apart / max(gains.size, 1)), [0.5, 0.5]])
    drawn = rng.multinomial(gains.size + 1, chance / chance.sum(), REPLICATES)
    share = rng.binomial(n + 2, (apart + 1) / (n + 2), REPLICATES) / (n + 2)
    replicates = share * (drawn @ (heavy * pool)) / (drawn @ heavy)
    low, high = np.quantile(replicates, [(1 - level) / 2, (1 + level) / 2])
    return Interval(estimate, min(float(low), estimate), max(float(high), estimate))


def mean_difference(one: Array, other: Array, rng: np.random.Generator, *, level: float = 0.95) -> Interval:
    """Mean of one - other over the same attempts, with the same bootstrap over attempts.

    Args:
        one, other: gains of the same attempts, shape (n,), n >= 1.
        rng: source of the draws.
        level: coverage of the two-sided interval.
    """
    differences = one - other
    pool = np.concatenate([differences, [0.0, 1.0, -1.0]])
    chance = np.concatenate([np.ones(one.size), [1.0, 0.5, 0.5]])
    drawn = rng.multinomial(one.size + 2, chance / chance.sum(), REPLICATES)
    low, high = np.quantile(drawn @ pool / (one.size + 2), [(1 - level) / 2, (1 + level) / 2])
    estimate = float(differences.mean())
    return Interval(estimate, min(float(low), estimate), max(float(high), estimate))
