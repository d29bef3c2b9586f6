"""Paired outcomes: two policies on the same scenes; only the scenes that they end differently tell them apart."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import sqrt
from statistics import NormalDist
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]
from scipy.special import bdtr, bdtrc, betaincinv, gammaln, xlog1py, xlogy  # pyright: ignore[reportMissingTypeStubs]

from pipeline.errors import ConfigError

type Outcomes = NDArray[np.bool_]
type Rates = NDArray[np.float64]

NUISANCE_SHARE = 1 / 40
"""Part of the error that pays for not searching discordance rates that the data rule out (Berger and Boos)."""


@dataclass(frozen=True, slots=True)
class Pairs:
    """Counts of a paired comparison; fixed + broken are the discordant scenes."""

    n: int
    candidate: int
    """Scenes the candidate solves."""
    champion: int
    """Scenes the champion solves."""
    fixed: int
    """Scenes the champion fails and the candidate solves."""
    broken: int
    """Scenes the champion solves and the candidate fails."""


@dataclass(frozen=True, slots=True)
class McNemar:
    """Exact p values of equal success rates, not corrected for anything."""

    p_gain: float
    """Against the candidate being better."""
    p_loss: float
    """Against the candidate being worse."""
    p_two_sided: float


def compare(candidate: Outcomes, champion: Outcomes) -> Pairs:
    """Count what two policies did with the same scenes.

    Args:
        candidate: solved or not, shape (n,), in the order of the scenes.
        champion: the same scenes, shape (n,).

    Raises:
        ConfigError: the shapes differ: the outcomes are not of the same scenes.
    """
    if candidate.shape != champion.shape or candidate.ndim != 1:
        raise ConfigError(f"outcomes of shape {candidate.shape} and {champion.shape} are no pairs",
                          where="paired comparison", mend="run both policies on the same scenes, in one order")
    return Pairs(n=candidate.size, candidate=int(candidate.sum()), champion=int(champion.sum()),
                 fixed=int((candidate & ~champion).sum()), broken=int((champion & ~candidate).sum()))


def mcnemar(fixed: int, broken: int) -> McNemar:
    """Exact McNemar test: under equal rates a discordant scene is fixed or broken like a fair coin.

    With m = fixed + broken and X ~ Bin(m, 1/2): p_gain = P(X >= fixed), p_loss = P(X >= broken), and the two-sided
    p is twice the smaller, at most 1. No discordant scene gives 1 throughout.

    Raises:
        ConfigError: a count below 0.

    Source: McNemar 1947, Psychometrika 12:153; exact form in Fay and Lumbard 2021, Statistics in Medicine 40:1147.
    """
    if fixed < 0 or broken < 0:
        raise ConfigError(f"{fixed} fixed and {broken} broken scenes are no counts", where="mcnemar",
                          mend="count discordant scenes with compare()")
    gain, loss = (float(bdtrc(x - 1, fixed + broken, 0.5)) if x else 1.0 for x in (fixed, broken))
    return McNemar(p_gain=min(1.0, gain), p_loss=min(1.0, loss), p_two_sided=min(1.0, 2 * min(gain, loss)))


def score(broken: NDArray[np.float64] | float, fixed: NDArray[np.float64] | float, n: int,
          loss: float) -> NDArray[np.float64]:
    """Tango's score statistic of "the candidate loses `loss` of the scenes"; low values speak for a smaller loss.

    (b - c - n d) / sqrt(n (2 q + d - d^2)), where q is the rate of fixed scenes that the counts b, c make likeliest
    under the loss d: the larger root of 2n q^2 + ((2n - b + c) d - b - c) q - c d (1 - d) = 0.

    Args:
        broken: b, counts, any shape.
        fixed: c, counts, broadcast against b.
        n: scenes.
        loss: d, in (-1, 1).

    Source: Tango 1998, Statistics in Medicine 17:891.
    """
    b, c, d = np.asarray(broken, np.float64), np.asarray(fixed, np.float64), loss
    half = (2 * n - b + c) * d - b - c
    q = (np.sqrt(np.maximum(half * half + 8 * n * c * d * (1 - d), 0)) - half) / (4 * n)
    return (b - c - n * d) / np.sqrt(np.maximum(n * (2 * q + d - d * d), 1e-12))


def tango_upper(fixed: int, broken: int, n: int, alpha: float) -> float:
    """One-sided upper limit of the loss by inverting Tango's score test: the approximation that loss_upper corrects."""
    z = NormalDist().inv_cdf(1 - alpha)
    return _crossing(lambda loss: float(score(broken, fixed, n, loss)) + z, (broken - fixed) / n, 1.0)


@lru_cache(maxsize=16384)
def loss_upper(fixed: int, broken: int, n: int, alpha: float) -> float:
    """Upper bound of the share of scenes lost, true with probability 1 - alpha or more whatever the rates are.

    The loss is P(broken) - P(fixed), the success of the champion minus that of the candidate. Tango's score limit is
    the right size but now and then a little too small for few scenes, so it only orders the tables: the bound is the
    largest loss under which tables at least as good as the observed one still have a probability above alpha, at the
    worst discordance rate (Buehler's construction). Discordance rates that the data rule out at alpha / 40 are not
    searched and that alpha / 40 is paid for (Berger and Boos). The maximum is taken on a grid that is refined once.

    Args:
        fixed: scenes only the candidate solves.
        broken: scenes only the champion solves.
        n: scenes, discordant or not; 0 gives 1, as nothing is known.
        alpha: error of the one-sided bound, in (0, 0.5).

    Returns:
        Bound in (-1, 1]; negative where the candidate is shown to be better.

    Raises:
        ConfigError: more discordant scenes than scenes, or alpha outside (0, 0.5).

    Source: Buehler 1957, JASA 52:482 (the smallest bound that respects an order and always covers);
    Berger and Boos 1994, JASA 89:1012; Hsueh, Liu, Chen 2001, Biometrics 57:478 (this test, for one margin).
    """
    if min(fixed, broken) < 0 or fixed + broken > n or not 0 < alpha < 0.5:
        raise ConfigError(f"{fixed} fixed and {broken} broken of {n} scenes at alpha {alpha}", where="loss bound",
                          mend="count discordant scenes with compare(); alpha lies between 0 and 0.5")
    if broken == n:
        return 1.0
    limit = tango_upper(fixed, broken, n, alpha)
    counts = np.arange(n + 1)
    largest = _largest_broken(counts, n, limit, NormalDist().inv_cdf(1 - alpha), (fixed, broken))
    low, high = _clopper_pearson(fixed + broken, n, alpha * NUISANCE_SHARE)

    def excess(loss: float) -> float:
        return _worst_tail(largest, n, loss, max(low, abs(loss)), high) - alpha * (1 - NUISANCE_SHARE)

    return _crossing(excess, max((broken - fixed) / n, limit - 0.02), min(high, limit + 0.02))


def _largest_broken(fixed: NDArray[np.int_], n: int, limit: float, z: float,
                    seen: tuple[int, int]) -> NDArray[np.int_]:
    """For each count of fixed scenes the most broken ones of a table as good as the one seen; -1 for none."""
    low, high = np.full(n + 1, -1), n - fixed
    while (low < high).any():
        middle = (low + high + 1) // 2
        good = score(middle.astype(np.float64), fixed.astype(np.float64), n, limit) <= -z + 1e-6
        low, high = np.where(good, middle, low), np.where(good, high, middle - 1)
    low[seen[0]] = max(low[seen[0]], seen[1])  # the table itself belongs to its own set, whatever the rounding
    return low


def _worst_tail(largest: NDArray[np.int_], n: int, loss: float, low: float, high: float) -> float:
    """Largest probability of {broken <= largest[fixed]} over discordance rates in [low, high]."""
    if low >= high:
        return float(_tail(largest, n, loss, np.array([low]))[0])
    grid: Rates = np.linspace(low, high, 33, dtype=np.float64)
    values = _tail(largest, n, loss, grid)
    best = int(values.argmax())
    fine: Rates = np.linspace(float(grid[max(best - 1, 0)]), float(grid[min(best + 1, 32)]), 13, dtype=np.float64)
    return float(max(values[best], _tail(largest, n, loss, fine).max()))


def _tail(largest: NDArray[np.int_], n: int, loss: float, discordance: Rates) -> Rates:
    """P(broken <= largest[fixed]) at each discordance rate: fixed is binomial, broken given fixed is too."""
    p_fixed = np.clip((discordance - loss)[:, None] / 2, 0, 1)
    p_broken = (discordance + loss)[:, None] / 2
    least, most = float(p_fixed.min()), float(p_fixed.max())
    start = max(0, int(n * least - 9 * sqrt(n * least * (1 - least)) - 12))
    stop = min(n, int(n * most + 9 * sqrt(n * most * (1 - most)) + 12)) + 1  # outside less than 1e-15 is left
    fixed = np.arange(start, stop)
    kept = fixed[largest[start:stop] >= 0]
    share = np.clip(p_broken / np.maximum(1 - p_fixed, 1e-12), 0, 1)
    tail = bdtr(largest[kept].astype(np.float64), n - kept, np.broadcast_to(share, (share.size, kept.size)))
    ways = gammaln(n + 1) - gammaln(kept + 1) - gammaln(n - kept + 1)
    return (np.exp(ways + xlogy(kept, p_fixed) + xlog1py(n - kept, -p_fixed)) * tail).sum(axis=1)


def _clopper_pearson(count: int, n: int, alpha: float) -> tuple[float, float]:
    """Two-sided exact interval of a proportion (Clopper and Pearson 1934, Biometrika 26:404)."""
    low = 0.0 if count == 0 else float(betaincinv(count, n - count + 1, alpha / 2))
    return low, 1.0 if count == n else float(betaincinv(count + 1, n - count, 1 - alpha / 2))


def _crossing(falling: Callable[[float], float], low: float, high: float) -> float:
    """The point where a falling function meets 0, to 1e-7 and on the high side; the bracket is widened if need be."""
    low, high = max(low, -1.0 + 1e-9), min(high, 1.0 - 1e-9)
    while falling(high) > 0:
        if high >= 1 - 1e-9:
            return 1.0
        low, high = high, min(1 - 1e-9, high + 0.1)
    while falling(low) <= 0 and low > -1 + 1e-9:
        low, high = max(-1 + 1e-9, low - 0.1), low
    return min(1.0, cast(float, brentq(falling, low, high, xtol=1e-7)) + 1e-7)
