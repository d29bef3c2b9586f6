"""Proportions: a success rate of one policy and how far it can be trusted."""

from collections.abc import Mapping
from math import sqrt
from statistics import NormalDist

from pipeline.errors import ConfigError
from schemas.verdict import Proportion


def wilson(successes: int, n: int, level: float = 0.95) -> Proportion:
    """Successes among n with a two-sided Wilson score interval.

    The interval holds every p with |successes/n - p| <= z sqrt(p (1 - p) / n), that is

        (p^ + z^2/2n +- z sqrt(p^ (1 - p^)/n + z^2/4n^2)) / (1 + z^2/n).

    Its mean coverage is close to `level` also near 0 and 1, where the usual p +- z se fails. With n = 0 nothing
    is known: rate 0, interval [0, 1].

    Args:
        successes: attempts that succeeded, 0..n.
        n: independent attempts.
        level: coverage of the two-sided interval, in (0, 1).

    Raises:
        ConfigError: successes outside 0..n, or level outside (0, 1).

    Source: Wilson 1927, JASA 22:209; Brown, Cai, DasGupta 2001, Statistical Science 16:101.
    """
    if not 0 <= successes <= n or not 0 < level < 1:
        raise ConfigError(f"{successes} successes of {n} at level {level} is no proportion", where="wilson",
                          mend="count successes among the attempts themselves; a level lies between 0 and 1")
    if n == 0:
        return Proportion(n=0, successes=0, rate=0.0, low=0.0, high=1.0)
    z = NormalDist().inv_cdf((1 + level) / 2)
    rate = successes / n
    middle = (rate + z * z / (2 * n)) / (1 + z * z / n)
    half = z * sqrt(rate * (1 - rate) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    low = 0.0 if successes == 0 else min(rate, max(0.0, middle - half))  # exact at the ends, whatever the rounding
    high = 1.0 if successes == n else max(rate, min(1.0, middle + half))
    return Proportion(n=n, successes=successes, rate=rate, low=low, high=high)


def deployment_mix(strata: Mapping[str, Proportion], shares: Mapping[str, float], level: float = 0.95) -> Proportion:
    """Success rate of a mixture of strata that were sampled apart, e.g. 0.88 common and 0.12 rare.

    rate = sum w p, and with each stratum's Wilson limits l, u the limits are recovered from their distances,

        low = rate - sqrt(sum w^2 (p - l)^2),   high = rate + sqrt(sum w^2 (u - p)^2),

    which keeps the skew of a stratum near 0 or 1. `n` and `successes` of the answer are plain sums over the
    strata, so successes / n is not the rate.

    Args:
        strata: stratum -> its proportion, as wilson gives it (its interval is computed anew at `level`).
        shares: stratum -> share of the mixture; the shares of all named strata sum to 1.
        level: coverage of the two-sided interval.

    Raises:
        ConfigError: shares do not sum to 1, or name a stratum that was not tried.

    Source: Zou, Huang, Zhang 2009, Computational Statistics & Data Analysis 53:1080 (limits of a linear function
    of proportions); Newcombe 1998, Statistics in Medicine 17:873, method 10, is the case of two strata.
    """
    if missing := sorted(name for name in shares if name not in strata or strata[name].n == 0):
        raise ConfigError(f"no attempt in stratum {', '.join(missing)}", where="deployment mix",
                          mend="try scenes of every stratum that the mixture names")
    if min(shares.values(), default=-1.0) < 0 or abs(sum(shares.values()) - 1) > 1e-9:
        raise ConfigError(f"shares {dict(shares)} do not sum to 1", where="deployment mix",
                          mend="give every stratum its share, e.g. common 0.88, rare 0.12")
    parts = [(share, wilson(strata[name].successes, strata[name].n, level)) for name, share in shares.items()]
    rate = min(1.0, sum(w * p.rate for w, p in parts))
    below = sqrt(sum((w * (p.rate - p.low)) ** 2 for w, p in parts))
    above = sqrt(sum((w * (p.high - p.rate)) ** 2 for w, p in parts))
    return Proportion(n=sum(p.n for _, p in parts), successes=sum(p.successes for _, p in parts), rate=rate,
                      low=max(0.0, rate - below), high=min(1.0, rate + above))
