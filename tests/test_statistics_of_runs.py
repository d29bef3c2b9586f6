"""Statistics over whole runs: seeds drawn again, then scenes or episodes; how well one rate foretells another."""

import numpy as np
import pytest
from scipy import stats

from pipeline.errors import ConfigError
from pipeline.statistics import (
    bootstrap_difference,
    bootstrap_interquartile,
    interquartile_mean,
    predict_quality,
    sign_test,
)


def test_bootstrap_gives_the_interval_of_resampling_scene_by_scene():
    rng = np.random.default_rng(5)
    first, second = rng.random((4, 30)) < 0.8, rng.random((4, 30)) < 0.6
    fast = bootstrap_difference({"all": (first, second)}, {"all": 1.0}, np.random.default_rng(0), replicates=20_000)
    difference = first.astype(float) - second
    slow = [np.mean([rng.choice(difference[s], 30) for s in rng.integers(4, size=4)]) for _ in range(4000)]
    assert fast.estimate == pytest.approx(difference.mean())
    assert (fast.low, fast.high) == pytest.approx(tuple(np.quantile(slow, [0.025, 0.975])), abs=0.02)


def test_bootstrap_repeats_itself_and_knows_equal_arms():
    rng = np.random.default_rng(5)
    arm, other = rng.random((8, 300)) < 0.9, rng.random((8, 300)) < 0.8
    strata, shares = {"common": (arm, other), "rare": (arm[:, :100], other[:, :100])}, {"common": 0.88, "rare": 0.12}
    a, b = (bootstrap_difference(strata, shares, np.random.default_rng(7)) for _ in range(2))
    assert a == b and a.low < a.estimate < a.high
    equal = bootstrap_difference({"all": (arm, arm)}, {"all": 1.0}, rng)
    assert (equal.estimate, equal.low, equal.high) == (0, 0, 0)


def test_bootstrap_over_eight_seeds_covers_the_true_difference():
    rng = np.random.default_rng(6)
    hits = 0
    for k in range(400):
        gain = np.clip(rng.normal(0.1, 0.04, (8, 1)), 0, 0.2)  # seeds differ, as trainings do
        arms = rng.random((8, 200)) < 0.75 + gain, rng.random((8, 200)) < 0.75
        found = bootstrap_difference({"all": arms}, {"all": 1.0}, np.random.default_rng(k), replicates=1000)
        hits += found.low <= 0.1 <= found.high
    assert hits / 400 > 0.9


@pytest.mark.parametrize("arms", [((3, 10), (3, 9)), ((3, 10), (2, 10)), ((3, 0), (3, 0)), ((10,), (10,))], ids=str)
def test_bootstrap_refuses_arms_that_are_not_paired(arms):
    with pytest.raises(ConfigError, match="mend: give both arms as"):
        bootstrap_difference({"all": (np.ones(arms[0], bool), np.ones(arms[1], bool))}, {"all": 1.0},
                             np.random.default_rng(0))


def test_bootstrap_refuses_shares_of_other_strata():
    arm = np.ones((2, 5), bool)
    with pytest.raises(ConfigError, match="mend: give each stratum its share"):
        bootstrap_difference({"common": (arm, arm)}, {"rare": 1.0}, np.random.default_rng(0))


@pytest.mark.parametrize(("differences", "p"), [([0.1] * 3, 0.125), ([0.1] * 8, 1 / 256), ([0.1, -0.1, 0.0], 0.75)])
def test_sign_test_counts_seeds(differences, p):
    assert sign_test(differences).p_one_sided == pytest.approx(p)


# Gate against exam


def test_a_perfect_prediction_orders_everything_right():
    told = predict_quality([0.8, 0.9, 0.95], [0.5, 0.6, 0.7])
    assert (told.sign_agreement, told.rank_violation) == (1, 0)
    assert told.pearson == pytest.approx(stats.pearsonr([0.8, 0.9, 0.95], [0.5, 0.6, 0.7])[0])


def test_a_wrong_ordering_costs_the_exam_points_at_stake():
    told = predict_quality([0.9, 0.8, 0.95], [0.5, 0.7, 0.9])  # the first two are swapped, 20 points apart
    assert told.sign_agreement == pytest.approx(2 / 3)
    assert told.rank_violation == pytest.approx((0.2 + 0.2 + 0) / 3)


def test_too_few_or_constant_rates_give_no_correlation():
    assert predict_quality([0.8, 0.9], [0.5, 0.6]).pearson is None
    assert predict_quality([0.8, 0.8, 0.8], [0.5, 0.6, 0.7]).pearson is None
    assert predict_quality([0.8], [0.5]).sign_agreement is None


def test_prediction_refuses_rates_of_different_policies():
    with pytest.raises(ConfigError, match="mend: give both rates of every policy"):
        predict_quality([0.8, 0.9], [0.5])


def test_the_interquartile_mean_is_scipys_trimmed_mean():
    rng = np.random.default_rng(0)
    for shape in ((1, 1), (1, 3), (3, 150), (2, 7)):
        values = rng.normal(size=shape)
        assert np.allclose(interquartile_mean(values), stats.trim_mean(values, 0.25, axis=1))


def test_the_interquartile_interval_knows_seeds_from_episodes():
    rng = np.random.default_rng(0)
    alike = rng.normal(100, 10, (3, 150))
    apart = alike + np.array([[0.0], [100.0], [200.0]])
    a, b = (bootstrap_interquartile(apart, np.random.default_rng(1), replicates=500) for _ in range(2))
    assert a == b and a.low < a.estimate < a.high
    assert a.high - a.low > 150  # three seeds as far apart as that say little
    narrow = bootstrap_interquartile(alike, np.random.default_rng(1), replicates=500)
    assert narrow.high - narrow.low < 10
    same = bootstrap_interquartile(np.full((3, 4), 7.0), rng, replicates=10)
    assert (same.estimate, same.low, same.high) == (7, 7, 7)


@pytest.mark.parametrize("shape", [(3,), (0, 5), (3, 0)], ids=["one row", "no seeds", "no episodes"])
def test_the_interquartile_interval_refuses_what_is_no_table_of_returns(shape):
    with pytest.raises(ConfigError, match=r"mend: give \(seeds, attempts\)"):
        bootstrap_interquartile(np.ones(shape), np.random.default_rng(0))
