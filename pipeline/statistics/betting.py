"""Bets on paired outcomes: capital that can only grow by luck while a claim is true, and may be read at any moment.

A bettor who doubts a claim starts with capital 1 and bets at odds that are fair, or worse, as long as the claim is
true. So the capital is a non-negative supermartingale under the claim: it reaches 1 / alpha with probability alpha at
most, however often it is read and whatever decides when to stop (Ville 1939). Both capitals here are functions of
counts alone, so a verdict can be checked with a pocket calculator. See docs/decisions/016-a-gate-for-every-night.md.
"""

from collections.abc import Callable
from math import log

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr, gammaln, xlog1py, xlogy  # pyright: ignore[reportMissingTypeStubs]

from pipeline.errors import ConfigError

type Reals = NDArray[np.float64]
type Counts = NDArray[np.int64]
type Numbers = Counts | Reals | float

FRACTIONS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0)
"""Bets on the bound of a loss, as shares of the largest one that can never go broke before the last broken scene."""

NEVER = 50.0
"""A number of scenes this many times those seen is called none at all."""


def log_gain(fixed: Numbers, broken: Numbers) -> Reals:
    """Log capital against "a discordant scene is broken at least as often as fixed": the candidate is no better.

    A bet on "fixed with probability q" multiplies the capital by 2q at a fixed scene and by 2 (1 - q) at a broken
    one. Spreading it evenly over all q between 1/2 and 1 gives, with m = fixed + broken,

        2 * integral from 1/2 to 1 of (2q)^fixed (2 (1 - q))^broken dq
          = 2^(m + 1) fixed! broken! / (m + 1)! * P(Bin(m + 1, 1/2) <= fixed).

    Args:
        fixed: scenes only the candidate solves, any shape.
        broken: scenes only the champion solves, broadcast against it.

    Returns:
        Natural logarithm of the capital; -inf where nothing is left within double precision.

    Source: Ville 1939, Etude critique de la notion de collectif; Robbins 1970, Ann. Math. Statist. 41:1397 (mixtures);
    Shafer 2021, J. R. Statist. Soc. A 184:407 (bets as tests); Gruenwald, de Heide, Koolen 2024, JRSSB 86:1091.
    """
    f, b = np.asarray(fixed, np.float64), np.asarray(broken, np.float64)
    with np.errstate(divide="ignore"):
        above = np.log(bdtr(f, (f + b + 1).astype(np.int64), 0.5))
    return log(2) * (f + b + 1) + gammaln(f + 1) + gammaln(b + 1) - gammaln(f + b + 2) + above


def log_bound(fixed: Numbers, broken: Numbers, n: Numbers, margin: float) -> Reals:
    """Log capital against "the candidate loses `margin` of the scenes or more".

    With x = 1 at a broken scene, -1 at a fixed one and 0 else, the claim says E x >= margin, so a bet of
    lambda multiplies the capital by 1 + lambda (margin - x), on average by 1 at most. The capital is split evenly over
    lambda = c / (1 - margin) for the six c of FRACTIONS: mean over c of
    (1 + lambda (margin + 1))^fixed (1 + lambda margin)^(n - fixed - broken) (1 + lambda (margin - 1))^broken.

    Args:
        fixed, broken: discordant scenes, any shape.
        n: all scenes, discordant or not, broadcast against them.
        margin: loss of the claim, in (-1, 1).

    Source: Waudby-Smith and Ramdas 2024, J. R. Statist. Soc. B 86:1 (capital processes for bounded means).
    """
    f, b, total = (np.asarray(x, np.float64)[..., None] for x in (fixed, broken, n))
    bet = np.asarray(FRACTIONS) / (1 - margin)
    parts = (xlog1py(f, bet * (margin + 1)) + xlog1py(total - f - b, bet * margin)
             + xlogy(b, 1 - bet * (1 - margin)))
    top = parts.max(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        return top[..., 0] + np.log(np.exp(parts - top).mean(axis=-1))


def loss_upper_by_bets(fixed: int, broken: int, n: int, alpha: float) -> float:
    """Upper bound of the share of scenes lost, at any moment: true at all moments together with 1 - alpha or more.

    The smallest margin whose claim "at least this much is lost" has lost against capital 1 / alpha; 1 where none has.

    Raises:
        ConfigError: more discordant scenes than scenes, or alpha outside (0, 0.5).
    """
    if min(fixed, broken) < 0 or fixed + broken > n or not 0 < alpha < 0.5:
        raise ConfigError(f"{fixed} fixed and {broken} broken of {n} scenes at alpha {alpha}", where="loss bound",
                          mend="count discordant scenes with compare(); alpha lies between 0 and 0.5")
    low, high = -1.0 + 1e-6, 1.0 - 1e-6
    if log_bound(fixed, broken, n, high) < -log(alpha):
        return 1.0
    while high - low > 1e-7:
        middle = (low + high) / 2
        low, high = (low, middle) if log_bound(fixed, broken, n, middle) >= -log(alpha) else (middle, high)
    return high


def times_further(reached: Callable[[float], bool]) -> float | None:
    """By how much all counts must grow, at the rates seen, until `reached`; None where NEVER times is not enough."""
    if not reached(NEVER):
        return None
    low, high = 1.0, NEVER
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (low, middle) if reached(middle) else (middle, high)
    return high
