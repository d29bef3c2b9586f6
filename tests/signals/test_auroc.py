"""AUROC against scipy, and an interval over runs and attempts."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from pipeline.errors import ConfigError
from pipeline.statistics.auroc import Scored, auroc, pooled_auroc


def run(seed: int, n: int = 200, gap: float = 1.0) -> Scored:
    rng = np.random.default_rng(seed)
    failed = rng.random(n) < 0.2
    return Scored(np.round(rng.normal(size=n) + gap * failed, 1), failed)  # rounded: ties count half


def test_it_is_the_mann_whitney_statistic_over_the_pairs():
    one = run(0)
    bad, good = one.scores[one.failed], one.scores[~one.failed]
    assert auroc(one.scores, one.failed) == pytest.approx(mannwhitneyu(bad, good).statistic / (len(bad) * len(good)))


def test_attempts_of_which_nothing_is_known_count_for_nothing():
    one = run(1)
    scores = np.append(one.scores, [np.nan, np.nan])
    assert auroc(scores, np.append(one.failed, [True, False])) == auroc(one.scores, one.failed)
    assert np.isnan(auroc(one.scores, np.zeros(200, bool)))


def test_the_interval_is_wider_where_runs_differ_and_holds_the_truth():
    alike, unlike = [run(k) for k in range(8)], [run(k, gap=2.0 * (k % 2)) for k in range(8)]
    same, mixed = (pooled_auroc(runs, np.random.default_rng(0), replicates=400) for runs in (alike, unlike))
    assert same.low < 0.760 < same.high, "two normals one apart: 0.760"
    assert same.low < same.estimate < same.high
    assert mixed.high - mixed.low > 1.5 * (same.high - same.low)
    assert same == pooled_auroc(alike, np.random.default_rng(0), replicates=400)


def test_runs_without_failures_are_left_out():
    nothing = Scored(np.ones(5), np.zeros(5, bool))
    assert pooled_auroc([nothing], np.random.default_rng(0)) is None
    one = pooled_auroc([run(0), nothing], np.random.default_rng(0), replicates=50)
    assert one.estimate == auroc(run(0).scores, run(0).failed)


def test_scores_that_do_not_belong_to_the_attempts_are_refused():
    with pytest.raises(ConfigError, match=r"3 scores for 2 attempts(.|\n)*mend: give one score for each attempt"):
        pooled_auroc([Scored(np.ones(3), np.ones(2, bool))], np.random.default_rng(0))
