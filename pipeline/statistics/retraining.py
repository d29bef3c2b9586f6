"""Two ways of training, each with seeds of its own, on common scenes: by how much they differ, and how surely.

Seeds are the readers and scenes the cases of a reader study in which every reader reads with one method only: seeds are
nested in the way of training, scenes are crossed with both. With success y[a, i, j] of way a, seed i and scene j,

    y[a, i, j] = m[a] + seed[a, i] + scene[j] + (scene x way)[a, j] + rest[a, i, j],

the difference of the means has three sources of error. Their mean squares are estimated without a distribution:
S2[a], the variance of the means of the seeds of one way; D2, the variance over scenes of the difference of their
means; E2[a], the mean square of what is left after seed and scene. Both S2 / k and D2 / n hold the rest once, so

    V = S2[1] / k[1] + S2[0] / k[0] + D2 / n - E2[1] / (k[1] n) - E2[0] / (k[0] n),

never below what seeds alone or scenes alone would give. Where all scenes of a stratum agree, D2 is taken as 1 / n, as
if one of them had ended otherwise: n scenes without an exception do not prove that there is none. The interval is
Student's, its degrees of freedom Satterthwaite's. The p value is the larger of the interval's own and of the exact
permutation of seeds, which needs no model: if both ways train equally good policies, every split of the seeds into two
groups is as likely as the one seen.

Source: Obuchowski 1995, Academic Radiology 2:S22, and Hillis 2014, Statistics in Medicine 33:330 (readers nested in
methods, cases crossed); Cornfield and Tukey 1956, Ann. Math. Stat. 27:907; Satterthwaite 1946, Biometrics 2:110;
Phipson and Smyth 2010, Stat. Appl. Genet. Mol. Biol. 9:39 (a permutation p value is never 0).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import comb, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from pipeline.errors import ConfigError

type Runs = NDArray[np.bool_]
"""Outcomes, shape (seeds, scenes)."""
type Rates = NDArray[np.float64]

MOST_SPLITS = 20_000
"""Splits of the seeds that are tried one by one; where there are more, as many are drawn."""


@dataclass(frozen=True, slots=True)
class Retrained:
    """The mean of the first way of training minus that of the second."""

    estimate: float
    low: float | None
    """None where a way has one seed: nothing is known of how seeds differ."""
    high: float | None
    p: float | None
    """Two-sided."""
    seeds_error: float
    """Standard error that more seeds would take away."""
    scenes_error: float
    """Standard error that only more scenes would take away."""


def retrained(strata: Mapping[str, tuple[Runs, Runs]], shares: Mapping[str, float], *,
              level: float = 0.95) -> Retrained:
    """Compare two ways of training whose seeds are unpaired draws, on common scenes.

    Args:
        strata: stratum -> outcomes of the first and of the second way, (seeds, scenes) each, scenes in one order.
        shares: stratum -> weight, summing to 1.
        level: coverage of the interval, over new seeds and new scenes.

    Raises:
        ConfigError: the ways have other scenes, or strata other seeds or shares.
    """
    _check(strata, shares)
    seeds = [next(iter(strata.values()))[way].shape[0] for way in (0, 1)]
    means: list[Rates] = [_weighted(strata, shares, way) for way in (0, 1)]
    estimate = float(means[0].mean() - means[1].mean())
    if min(seeds) < 2:
        return Retrained(estimate, None, None, None, 0.0, 0.0)
    by_seed = [_Part(float(m.var(ddof=1)) / k, k - 1) for m, k in zip(means, seeds, strict=True)]
    by_scene = [_scenes(first, second, shares[name]) for name, (first, second) in strata.items()]
    rest = [_rest(runs, shares[name]) for name, pair in strata.items() for runs in pair]
    seed, scene, left = (sum(part.variance for part in parts) for parts in (by_seed, by_scene, rest))
    variance = max(seed + scene - left, seed, scene)
    free = variance**2 / sum(part.variance**2 / part.free for part in (*by_seed, *by_scene, *rest))
    half = float(stdtrit(free, (1 + level) / 2)) * sqrt(variance)
    student = 2 * float(stdtr(free, -abs(estimate) / sqrt(variance)))
    return Retrained(estimate, max(estimate - half, -1.0), min(estimate + half, 1.0),
                     max(student, permuted(means[0], means[1])), sqrt(max(seed - left, 0.0)),
                     sqrt(max(scene - left, 0.0)))


class _Part(NamedTuple):
    """One source of error."""

    variance: float
    free: int
    """Degrees of freedom."""


def _scenes(first: Runs, second: Runs, share: float) -> _Part:
    """What the scenes of a stratum add: D2 / n, times the square of the share; above 0."""
    n = first.shape[1]
    between: Rates = np.mean(first, axis=0) - np.mean(second, axis=0)
    agree = n == 1 or float(np.ptp(between)) == 0
    return _Part(share**2 * (1 / n if agree else float(between.var(ddof=1))) / n, max(n - 1, 1))


def _rest(runs: Runs, share: float) -> _Part:
    """What neither the seed nor the scene explains, once more than it counts: E2 / (k n), times the share squared."""
    y = runs.astype(np.float64)
    residual = y - y.mean(0, keepdims=True) - y.mean(1, keepdims=True) + y.mean()
    free = max((y.shape[0] - 1) * (y.shape[1] - 1), 1)
    return _Part(share**2 * float((residual**2).sum()) / free / y.size, free)


def permuted(first: Rates, second: Rates) -> float:
    """Exact two-sided p of the difference of means over all splits of the seeds; drawn ones where they are too many.

    Args:
        first, second: one mean a seed, shapes (k,) and (m,).
    """
    pooled, k = np.concatenate([first, second]), first.size
    masks = _splits(pooled.size, k)
    sums = masks @ pooled
    every = sums / k - (pooled.sum() - sums) / (pooled.size - k)
    as_far = int((np.abs(every) >= abs(first.mean() - second.mean()) - 1e-12).sum())
    if len(masks) == comb(pooled.size, k):
        return as_far / len(masks)
    return (as_far + 1) / (len(masks) + 1)


@lru_cache(maxsize=8)
def _splits(n: int, k: int) -> NDArray[np.float64]:
    """Rows with k ones among n, every one or MOST_SPLITS drawn ones."""
    if comb(n, k) <= MOST_SPLITS:
        chosen = np.array(list(combinations(range(n), k)))
    else:
        chosen = np.argsort(np.random.default_rng([n, k]).random((MOST_SPLITS, n)), axis=1)[:, :k]
    masks = np.zeros((len(chosen), n))
    np.put_along_axis(masks, chosen, 1.0, axis=1)
    return masks


def _weighted(strata: Mapping[str, tuple[Runs, Runs]], shares: Mapping[str, float], way: int) -> Rates:
    """The success of each seed of one way, strata by their shares, shape (seeds,)."""
    return np.sum([shares[name] * np.mean(pair[way], axis=1) for name, pair in strata.items()], axis=0)


def _check(strata: Mapping[str, tuple[Runs, Runs]], shares: Mapping[str, float]) -> None:
    shapes = {name: (first.shape, second.shape) for name, (first, second) in strata.items()}
    seeds = {(first[0], second[0]) for first, second in shapes.values()}
    if len(seeds) != 1 or any(a[1:] != b[1:] or len(a) != 2 or 0 in a + b for a, b in shapes.values()):
        raise ConfigError(f"outcomes of shapes {shapes} are not of common scenes", where="retraining",
                          mend="play the same scenes with every seed of both ways")
    if set(shares) != set(strata) or abs(sum(shares.values()) - 1) > 1e-9:
        raise ConfigError(f"shares {dict(shares)} do not fit strata {sorted(strata)}", where="retraining",
                          mend="give each stratum its share; the shares sum to 1")
