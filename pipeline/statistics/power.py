"""How tests behave at a known truth: the design with a fixed number of scenes exactly, the nightly rule by playing."""

from functools import lru_cache

import numpy as np
from scipy.special import bdtr, bdtrc, gammaln, xlog1py, xlogy  # pyright: ignore[reportMissingTypeStubs]

from pipeline.statistics.betting import Counts, Reals
from pipeline.statistics.nightly import Limits
from pipeline.statistics.nights import Chances, Tonight, play, table
from pipeline.statistics.paired import tango_upper
from pipeline.statistics.step import Operating

LARGEST = 100_000
"""Scenes beyond which no fixed design is planned."""


def fixed_power(n: int, fixed: Reals | float, broken: Reals | float, alpha: float) -> float:
    """Chance that the exact McNemar test of n scenes, looked at once, shows a gain.

    Sum over m of P(Bin(n, s) = m) P(Bin(m, fixed / s) >= c_m) with s = fixed + broken and c_m the smallest count
    whose one-sided p, P(Bin(m, 1/2) >= c_m), is at most alpha.

    Args:
        n: scenes.
        fixed, broken: chances of a discordant scene.
        alpha: error.
    """
    share = fixed + broken
    m = np.arange(n + 1)
    ways = gammaln(n + 1) - gammaln(m + 1) - gammaln(n - m + 1)
    weight = np.exp(ways + xlogy(m, share) + xlog1py(n - m, -share))
    shown = bdtrc(_critical(n, alpha).astype(np.float64) - 1, m, fixed / share)
    return float((weight * np.where(_critical(n, alpha) > m, 0.0, shown)).sum())


def fixed_size(fixed: Reals | float, broken: Reals | float, alpha: float, power: float) -> int:
    """Scenes that a fixed design needs for this power: the smallest n, but for the saw teeth of exact tests."""
    low, high = 1, 2
    while fixed_power(high, fixed, broken, alpha) < power and high < LARGEST:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if fixed_power(middle, fixed, broken, alpha) >= power else (middle, high)
    return high


def nightly_operating(chances: Chances, alpha: float, limits: Limits, *, batch: int, nights: int,
                      seed: int) -> Operating:
    """Share of nights that promote and scenes on average, over so many nights of one truth.

    Args:
        chances: of the outcomes of a scene by family, see nights.mixed, shape (3 families,).
        alpha: stake of each night.
        limits, batch: the rule.
        nights, seed: how many are played, and their random numbers.
    """
    truth = Tonight(np.broadcast_to(chances, (nights, chances.size)), np.zeros(nights, np.bool_))
    done = play(truth, np.full(nights, alpha), limits, batch, np.random.default_rng(seed), table())
    return Operating(float(done.promoted.mean()), float(done.scenes.mean()))


def fixed_whole(n: int, chances: Chances, alpha: float, margin: float, *, nights: int, seed: int) -> float:
    """Chance that n scenes, looked at once, show a gain and bound the loss of every family, by Tango's limit."""
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(n, chances, size=nights).reshape(nights, -1, 3)
    fixed, broken = counts[:, :, 0].sum(axis=1), counts[:, :, 1].sum(axis=1)
    shown = np.flatnonzero(fixed >= _critical(n, alpha)[fixed + broken])
    bounded = [all(tango_upper(int(f), int(b), int(f + b + c), alpha) < margin for f, b, c in counts[k])
               for k in shown]
    return sum(bounded) / nights


@lru_cache(maxsize=64)
def _critical(n: int, alpha: float) -> Counts:
    """Smallest significant count of fixed scenes for 0..n discordant ones; m + 1 where none is."""
    smallest, found = 0, np.zeros(n + 1, np.int64)
    for m in range(n + 1):
        while smallest <= m and 1 - float(bdtr(smallest - 1, m, 0.5) if smallest else 0.0) > alpha:
            smallest += 1
        found[m] = smallest
    return found
