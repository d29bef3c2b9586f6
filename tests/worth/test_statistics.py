"""Two ways of training on common scenes: the interval covers, equal ways are rarely called different."""

import numpy as np
import pytest
from scipy.special import expit, logit
from scipy.stats import permutation_test

from pipeline.errors import ConfigError
from pipeline.statistics.retraining import permuted, retrained

HALVES = {"common": 0.5, "rare": 0.5}


def ways(rng, rates, seed_sd, scene_sd, own_sd, seeds=8, scenes=100):
    """Outcomes of two ways: seeds of their own, common scenes, and what a scene does to one way alone."""
    hard = scene_sd * rng.normal(size=scenes)
    pair = tuple(rng.random((seeds, scenes)) < expit(logit(rate) + seed_sd * rng.normal(size=(seeds, 1)) + hard
                                                     + own_sd * rng.normal(size=scenes)) for rate in rates)
    half = scenes // 2
    return {"common": tuple(w[:, :half] for w in pair), "rare": tuple(w[:, half:] for w in pair)}


WORLDS = {
    "seeds and scenes matter": ((0.9, 0.8), 0.5, 1.0, 0.5), "only scenes matter": ((0.5, 0.4), 0.0, 2.0, 0.0),
    "only seeds matter": ((0.9, 0.9), 0.8, 0.0, 0.0), "near the ceiling": ((0.98, 0.95), 0.5, 1.0, 0.3),
}


@pytest.mark.parametrize("world", WORLDS)
def test_95_intervals_hold_the_true_difference_about_95_times_in_100(world):
    rates, *spread = WORLDS[world]
    rng = np.random.default_rng(7)
    wide = np.hypot(np.hypot(*spread[:2]), spread[2])
    many = wide * rng.normal(size=100_000)
    true = float(expit(logit(rates[0]) + many).mean() - expit(logit(rates[1]) + many).mean())
    found = [retrained(ways(rng, rates, *spread), HALVES) for _ in range(160)]
    covered = np.mean([r.low <= true <= r.high for r in found])
    assert 0.9 <= covered <= 1
    assert np.mean([r.estimate for r in found]) == pytest.approx(true, abs=0.01)


def test_equal_batches_are_called_different_at_most_about_5_times_in_100():
    rng = np.random.default_rng(8)
    for seed_sd, scene_sd, seeds in ((0.5, 1.0, 8), (1.0, 0.5, 8), (0.0, 1.0, 4)):
        p = [retrained(ways(rng, (0.85, 0.85), seed_sd, scene_sd, 0.0, seeds), HALVES).p for _ in range(160)]
        assert np.mean([v <= 0.05 for v in p]) <= 0.09


def test_the_permutation_of_seeds_is_the_exact_one():
    rng = np.random.default_rng(9)
    first, second = rng.random(8), rng.random(8) + 0.2
    reference = permutation_test((first, second), lambda a, b, axis: a.mean(axis) - b.mean(axis), n_resamples=np.inf,
                                 vectorized=True)
    assert permuted(first, second) == pytest.approx(reference.pvalue, abs=1e-9)


def test_no_p_value_beats_the_number_of_ways_to_split_the_seeds():
    """8 and 8 seeds can be split in 12,870 ways, 3 and 3 in 20: three seeds a side can never show anything."""
    solved, failed = np.ones((8, 50), bool), np.zeros((8, 50), bool)
    assert retrained({"a": (solved, failed)}, {"a": 1.0}).p == pytest.approx(2 / 12_870)
    assert retrained({"a": (solved[:3], failed[:3])}, {"a": 1.0}).p == pytest.approx(0.1)


def test_scenes_without_an_exception_do_not_prove_that_there_is_none():
    solved = np.ones((8, 50), bool)
    same = retrained({"a": (solved, solved)}, {"a": 1.0})
    assert same.estimate == 0 and same.p == 1 and same.low < -0.02 and same.high > 0.02


def test_more_seeds_narrow_the_interval_and_one_seed_gives_none():
    rng = np.random.default_rng(10)
    few, many = (retrained(ways(rng, (0.9, 0.8), 0.8, 0.3, 0.0, k), HALVES) for k in (4, 32))
    assert many.high - many.low < 0.5 * (few.high - few.low)
    assert retrained(ways(rng, (0.9, 0.8), 0.8, 0.3, 0.0, 1), HALVES).low is None


def test_policies_that_played_other_scenes_are_refused():
    with pytest.raises(ConfigError, match="mend: play the same scenes"):
        retrained({"a": (np.ones((8, 50), bool), np.ones((8, 49), bool))}, {"a": 1.0})
    with pytest.raises(ConfigError, match="mend: give each stratum its share"):
        retrained({"a": (np.ones((8, 50), bool), np.ones((8, 50), bool))}, {"a": 0.5})
