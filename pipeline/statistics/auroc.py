"""AUROC: how well a number that is known early tells failures from successes, over several runs, with an interval."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.statistics.seeds import Interval

type Scores = NDArray[np.float64]
type Failed = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Scored:
    """One run: what a signal said of each attempt, and which of them failed."""

    scores: Scores
    """Higher means riskier; NaN where nothing was known, and the attempt counts for nothing, shape (n,)."""
    failed: Failed
    """Shape (n,)."""

    @property
    def split(self) -> tuple[Scores, Scores]:
        """Scores of the failures and of the successes, those that are known."""
        known = np.isfinite(self.scores)
        return self.scores[known & self.failed], self.scores[known & ~self.failed]


def auroc(scores: Scores, failed: Failed) -> float:
    """Chance that a random failure has a higher score than a random success, ties counting half.

    0.5 is a guess. NaN where there are no failures or no successes.

    Source: Hanley and McNeil 1982, Radiology 143:29; the Mann-Whitney statistic over the number of pairs.
    """
    bad, good = Scored(scores, failed).split
    return float(_weighted(bad, good, np.ones((1, len(bad))), np.ones((1, len(good))))[0])


def pooled_auroc(runs: Sequence[Scored], rng: np.random.Generator, *, replicates: int = 2000,
                 level: float = 0.95) -> Interval | None:
    """Mean AUROC over runs, with a percentile interval over runs and attempts; None where no run has both kinds.

    Each replicate draws runs with replacement and then, in each drawn run, its failures and its successes with
    replacement, each kind for itself: how many failed is not what is asked. Runs without failures, or without
    successes, say nothing and are left out.

    Args:
        runs: one for each twin.
        rng: source of the draws; the same state gives the same interval.
        replicates: number of bootstrap replicates.
        level: coverage of the two-sided interval.

    Raises:
        ConfigError: scores and failures of a run differ in shape.

    Source: Davison and Hinkley 1997, Bootstrap Methods and their Application, section 3.8.
    """
    for run in runs:
        if run.scores.shape != run.failed.shape:
            raise ConfigError(f"{run.scores.size} scores for {run.failed.size} attempts", where="AUROC",
                              mend="give one score for each attempt, NaN where there is none")
    split = [pair for pair in (run.split for run in runs) if len(pair[0]) and len(pair[1])]
    if not split:
        return None
    estimate, found = np.zeros(len(split)), np.zeros((len(split), replicates))
    for k, (bad, good) in enumerate(split):
        estimate[k] = _weighted(bad, good, np.ones((1, len(bad))), np.ones((1, len(good))))[0]
        found[k] = _weighted(bad, good, _draws(len(bad), replicates, rng), _draws(len(good), replicates, rng))
    drawn, which = (rng.integers(size, size=(len(split), replicates)) for size in (len(split), replicates))
    means: Scores = found[drawn, which].mean(axis=0)
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(estimate.mean()), float(low), float(high))


def _draws(n: int, replicates: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """How often each of n was drawn, shape (replicates, n)."""
    return rng.multinomial(n, np.full(n, 1 / n), size=replicates).astype(np.float64)


def _weighted(bad: Scores, good: Scores, bad_times: Scores, good_times: Scores) -> Scores:
    """AUROC where each score counts as often as it was drawn, shape (replicates,)."""
    if not (len(bad) and len(good)):
        return np.full(len(bad_times), np.nan)
    order = np.argsort(good)
    below = np.concatenate([np.zeros((len(good_times), 1)), np.cumsum(good_times[:, order], axis=1)], axis=1)
    left, right = (np.searchsorted(good[order], bad, side=side) for side in ("left", "right"))
    won = bad_times * (below[:, left] + below[:, right]) / 2
    return won.sum(axis=1) / (bad_times.sum(axis=1) * good_times.sum(axis=1))
