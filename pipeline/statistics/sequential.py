"""Looking more than once and asking more than one question, without promising more certainty than there is."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from math import ceil, e, log, sqrt
from statistics import NormalDist
from types import MappingProxyType
from typing import Literal

from pipeline.errors import ConfigError, unknown
from pipeline.statistics.paired import score

type Spending = Literal["pocock", "obrien-fleming"]

NORMAL = NormalDist()


def _pocock(t: float, alpha: float) -> float:
    return alpha * log(1 + (e - 1) * t)


def _obrien_fleming(t: float, alpha: float) -> float:
    return 2 - 2 * NORMAL.cdf(NORMAL.inv_cdf(1 - alpha / 2) / sqrt(t))


SPENDING: MappingProxyType[str, Callable[[float, float], float]] = MappingProxyType(
    {"pocock": _pocock, "obrien-fleming": _obrien_fleming})
"""Share of scenes seen, alpha -> error spent so far. Lan and DeMets 1983, Biometrika 70:659, after Pocock 1977 and
O'Brien and Fleming 1979."""


def spend(looks: Sequence[int], alpha: float, spending: Spending = "pocock") -> tuple[float, ...]:
    """Error that each look may spend; the parts sum to alpha.

    Look k tests at the nominal level alpha(t_k) - alpha(t_k-1) with t = scenes / scenes of the last look. By the
    union bound the chance of any false rejection is at most the sum of the levels, alpha, however the looks depend
    on each other: no normal approximation and no joint distribution is needed, and exact tests stay exact. The
    price is small: the exact Pocock level of three looks is about 0.021 where this gives about 0.017 (alpha 0.05).
    "pocock" spends early, "obrien-fleming" late.

    Args:
        looks: rising scene counts, fixed beforehand.
        alpha: error over all looks.
        spending: key of SPENDING.

    Raises:
        ConfigError: looks do not rise from above 0, alpha is outside (0, 0.5), or the name is unknown.

    Source: Lan and DeMets 1983, Biometrika 70:659; Jennison and Turnbull 2000, Group Sequential Methods, ch. 7.
    """
    if spending not in SPENDING:
        raise unknown("spending", spending, SPENDING)
    if not looks or list(looks) != sorted(set(looks)) or looks[0] < 1 or not 0 < alpha < 0.5:
        raise ConfigError(f"looks {tuple(looks)} at alpha {alpha}", where="error spending",
                          mend="give scene counts that rise from above 0, and an alpha between 0 and 0.5")
    spent = [0.0, *(SPENDING[spending](n / looks[-1], alpha) for n in looks)]
    return tuple(after - before for before, after in pairwise(spent))


def holm(p: Mapping[str, float]) -> dict[str, float]:
    """Adjusted p values of several questions asked at once: those at or below alpha may all be believed.

    Sorted p_1 <= ... <= p_m become max over j <= i of (m - j + 1) p_j, at most 1. Holm controls the chance of even
    one false rejection under any dependence; the overall rate and its strata share scenes, so nothing weaker in
    assumptions will do, and it is never less powerful than Bonferroni.

    Source: Holm 1979, Scandinavian J. Statistics 6:65.
    """
    adjusted: dict[str, float] = {}
    largest = 0.0
    for rank, name in enumerate(sorted(p, key=lambda key: p[key])):
        largest = max(largest, min(1.0, (len(p) - rank) * p[name]))
        adjusted[name] = largest
    return {name: adjusted[name] for name in p}


def outlook(z: float, seen: float, alpha: float) -> float:
    """Chance that a test will be significant at the last look, given its statistic now.

    Predictive probability with a flat prior on the trend: with z after a share t of the scenes,
    Phi((z - z_alpha sqrt(t)) / sqrt(1 - t)). It may only be used to give up early: giving up can never promote, so
    it cannot raise the false promotion rate.

    Args:
        z: statistic so far, standard normal without an effect, large for an effect.
        seen: t, share of the budget that was played, in (0, 1].
        alpha: level of the last look for this question.

    Source: Spiegelhalter, Freedman, Blackburn 1986, Controlled Clinical Trials 7:8; Jennison and Turnbull 2000, ch. 10.
    """
    ahead = z - NORMAL.inv_cdf(1 - alpha) * sqrt(seen)
    return NORMAL.cdf(ahead / sqrt(1 - seen)) if seen < 1 else float(ahead >= 0)


def further_scenes_to_show(fixed: int, broken: int, n: int, alpha: float, power: float = 0.8) -> int | None:
    """Further scenes after which a gain at the rates seen would be significant with probability `power`.

    N = ((z_alpha sqrt(s) + z_power sqrt(s - d^2)) / d)^2 with d = (c - b) / n and s = (c + b) / n. None where
    d <= 0: there is no gain to show. For a loss, swap fixed and broken.

    Source: Miettinen 1968, Biometrics 24:339; Connor 1987, Biometrics 43:207.
    """
    if fixed <= broken:
        return None
    d, s = (fixed - broken) / n, (fixed + broken) / n
    needed = ((NORMAL.inv_cdf(1 - alpha) * sqrt(s) + NORMAL.inv_cdf(power) * sqrt(s - d * d)) / d) ** 2
    return max(1, ceil(needed) - n)


def further_scenes_to_bound(fixed: int, broken: int, n: int, alpha: float, margin: float,
                            power: float = 0.8) -> int | None:
    """Further scenes after which the upper bound of the loss would fall below the margin, at the rates seen.

    At constant rates Tango's statistic grows with sqrt(N), so N = n ((z_alpha + z_power) / score)^2; without a
    broken scene the exact log(alpha) / log(1 - margin). None where the loss seen is not below the margin.
    """
    if broken == 0:
        return max(1, ceil(log(alpha) / log(1 - margin)) - n)
    if broken - fixed >= margin * n:
        return None
    wanted = NORMAL.inv_cdf(1 - alpha) + NORMAL.inv_cdf(power)
    return max(1, ceil(n * (wanted / float(score(broken, fixed, n, margin))) ** 2) - n)
