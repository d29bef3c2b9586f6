"""Statistics: reference numbers of scipy and statsmodels, laws, and coverage where a guarantee is given."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from statsmodels.stats.contingency_tables import mcnemar as statsmodels_mcnemar
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

from pipeline.errors import ConfigError
from pipeline.statistics import (
    compare,
    deployment_mix,
    further_scenes_to_bound,
    further_scenes_to_show,
    holm,
    loss_upper,
    mcnemar,
    outlook,
    spend,
    wilson,
)
from pipeline.statistics.paired import tango_upper

counts = st.integers(1, 2000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))
tables = st.tuples(st.integers(0, 60), st.integers(0, 60), st.integers(0, 300)).map(
    lambda t: (t[0], t[1], sum(t) + 1))  # fixed, broken, scenes
relaxed = settings(deadline=None, max_examples=40)
levels = st.sampled_from([0.005, 0.0167, 0.05, 0.2])


# One policy


@pytest.mark.parametrize(("successes", "n"), [(0, 20), (190, 200), (57, 60), (400, 400), (1, 2)])
@pytest.mark.parametrize("level", [0.9, 0.95, 0.99])
def test_wilson_gives_the_reference_interval(successes, n, level):
    low, high = proportion_confint(successes, n, alpha=1 - level, method="wilson")
    p = wilson(successes, n, level)
    assert (p.low, p.high) == pytest.approx((low, high), abs=1e-12)
    assert (p.n, p.successes, p.rate) == (n, successes, successes / n)


@relaxed
@given(counts)
def test_wilson_contains_the_rate_and_is_symmetric(count):
    successes, n = count
    p, mirrored = wilson(successes, n), wilson(n - successes, n)
    assert 0 <= p.low <= p.rate <= p.high <= 1
    assert (1 - mirrored.high, 1 - mirrored.low) == pytest.approx((p.low, p.high), abs=1e-12)


@relaxed
@given(counts, st.integers(2, 10))
def test_wilson_narrows_with_more_attempts_at_the_same_rate(count, factor):
    few, many = wilson(*count), wilson(count[0] * factor, count[1] * factor)
    assert many.high - many.low < few.high - few.low


def test_wilson_of_no_attempts_knows_nothing():
    p = wilson(0, 0)
    assert (p.low, p.high) == (0, 1)


@pytest.mark.parametrize("bad", [(-1, 10, 0.95), (11, 10, 0.95), (1, 10, 1.0)], ids=["below 0", "above n", "level 1"])
def test_wilson_refuses_what_is_no_proportion(bad):
    with pytest.raises(ConfigError, match="mend: count successes"):
        wilson(*bad)


@relaxed
@given(counts)
def test_deployment_mix_of_one_stratum_is_wilson(count):
    mix, alone = deployment_mix({"all": wilson(*count)}, {"all": 1.0}), wilson(*count)
    assert (mix.rate, mix.low, mix.high) == pytest.approx((alone.rate, alone.low, alone.high), abs=1e-12)


def test_deployment_mix_weighs_strata_as_deployed_not_as_sampled():
    mix = deployment_mix({"common": wilson(285, 300), "rare": wilson(0, 100)}, {"common": 0.88, "rare": 0.12})
    assert mix.rate == pytest.approx(0.836)
    assert (mix.n, mix.successes) == (400, 285)
    assert mix.low < mix.rate < mix.high


@pytest.mark.parametrize("rates", [(0.95, 0.02), (0.97, 0.8), (0.5, 0.5), (0.99, 0.0)], ids=str)
def test_deployment_mix_covers_the_true_rate(rates):
    rng = np.random.default_rng(3)
    shares = {"common": 0.88, "rare": 0.12}
    truth = 0.88 * rates[0] + 0.12 * rates[1]
    hits = 0
    for _ in range(2000):
        mix = deployment_mix({"common": wilson(rng.binomial(300, rates[0]), 300),
                              "rare": wilson(rng.binomial(100, rates[1]), 100)}, shares)
        hits += mix.low <= truth <= mix.high
    assert hits / 2000 > 0.935  # 95 % less three standard errors of the simulation


def test_deployment_mix_refuses_a_stratum_that_was_never_tried():
    with pytest.raises(ConfigError, match=r"rare.*\n.*\n  mend: try scenes of every stratum"):
        deployment_mix({"common": wilson(9, 10), "rare": wilson(0, 0)}, {"common": 0.88, "rare": 0.12})


def test_deployment_mix_refuses_shares_that_do_not_sum_to_one():
    with pytest.raises(ConfigError, match="mend: give every stratum its share"):
        deployment_mix({"common": wilson(9, 10)}, {"common": 0.88})


# Two policies on the same scenes


@relaxed
@given(st.integers(0, 150), st.integers(0, 150))
def test_mcnemar_gives_the_reference_p_and_swaps_with_the_arms(fixed, broken):
    test, swapped = mcnemar(fixed, broken), mcnemar(broken, fixed)
    assert test.p_two_sided == pytest.approx(statsmodels_mcnemar([[0, broken], [fixed, 0]], exact=True).pvalue)
    assert (test.p_gain, test.p_loss) == (swapped.p_loss, swapped.p_gain)
    if fixed + broken:
        reference = stats.binomtest(fixed, fixed + broken, alternative="greater").pvalue
        assert test.p_gain == pytest.approx(reference, rel=1e-9)


def test_mcnemar_without_a_discordant_scene_says_nothing():
    assert mcnemar(0, 0).p_gain == mcnemar(0, 0).p_loss == mcnemar(0, 0).p_two_sided == 1


def test_compare_counts_what_each_policy_did():
    pairs = compare(np.array([1, 1, 0, 0, 1], bool), np.array([1, 0, 1, 0, 0], bool))
    assert (pairs.n, pairs.candidate, pairs.champion, pairs.fixed, pairs.broken) == (5, 3, 2, 2, 1)


def test_compare_refuses_outcomes_of_different_scenes():
    with pytest.raises(ConfigError, match="mend: run both policies on the same scenes"):
        compare(np.ones(3, bool), np.ones(4, bool))


@pytest.mark.parametrize("alpha", [0.05, 0.0167])
@pytest.mark.parametrize("n", [6, 14, 24])
def test_loss_bound_is_wrong_at_most_as_often_as_promised(n, alpha):
    """Exactly, by summing over every table, for a grid of truths finer than the one the bound searches."""
    cells = [(b, c) for b in range(n + 1) for c in range(n + 1 - b)]
    bound = np.array([loss_upper(c, b, n, alpha) for b, c in cells])
    b, c = np.array(cells).T
    for discordance in np.linspace(0.004, 0.99, 45):
        for share in np.linspace(0.02, 0.99, 40):
            p = np.array([discordance * share, discordance * (1 - share)])
            probability = stats.multinomial.pmf(np.stack([b, c, n - b - c], -1), n, [*p, 1 - p.sum()])
            assert probability[bound < p[0] - p[1]].sum() <= alpha + 1e-9, p


@relaxed
@given(tables, levels)
def test_loss_bound_moves_with_the_evidence(table, alpha):
    fixed, broken, n = table
    bound = loss_upper(fixed, broken, n, alpha)
    assert (broken - fixed) / n < bound <= 1
    assert loss_upper(fixed, broken + 1, n + 1, alpha) > bound - 1e-5
    assert loss_upper(fixed + 1, broken, n + 1, alpha) < bound + 1e-5


@pytest.mark.parametrize(("fixed", "broken", "n"), [(4, 4, 140), (13, 13, 280), (42, 1, 60), (20, 60, 800)])
def test_loss_bound_costs_little_over_tangos_approximation(fixed, broken, n):
    assert loss_upper(fixed, broken, n, 0.05) == pytest.approx(tango_upper(fixed, broken, n, 0.05), abs=0.008)


def test_nothing_broken_bounds_the_loss_only_with_enough_scenes():
    assert loss_upper(0, 0, 20, 0.05) == pytest.approx(0.14, abs=0.002)
    assert loss_upper(0, 0, 59, 0.05) <= 0.05 < loss_upper(0, 0, 57, 0.05)
    assert loss_upper(0, 0, 0, 0.05) == 1


def test_loss_bound_refuses_impossible_counts():
    with pytest.raises(ConfigError, match=r"mend: count discordant scenes with compare\(\)"):
        loss_upper(4, 4, 7, 0.05)


# Many looks, many questions


@pytest.mark.parametrize("spending", ["pocock", "obrien-fleming"])
@pytest.mark.parametrize("looks", [(200,), (200, 400, 800), (100, 200, 300, 400, 500)], ids=len)
def test_spending_keeps_the_error_over_all_looks(looks, spending):
    alphas = spend(looks, 0.05, spending)
    assert sum(alphas) == pytest.approx(0.05) and min(alphas) > 0
    t = np.array(looks) / looks[-1]
    correlation = np.sqrt(np.minimum.outer(t, t) / np.maximum.outer(t, t))
    never = stats.multivariate_normal.cdf(stats.norm.isf(alphas), cov=correlation, rng=np.random.default_rng(0))
    assert 0.03 < 1 - never <= 0.05 + 1e-4


def test_pocock_spends_early_and_obrien_fleming_late():
    looks = (200, 400, 800)
    assert spend(looks, 0.05)[0] > 100 * spend(looks, 0.05, "obrien-fleming")[0]
    assert all(a < b for a, b in pairwise(spend(looks, 0.05, "obrien-fleming")))


@pytest.mark.parametrize("looks", [(), (0, 10), (200, 200), (400, 200)], ids=["none", "zero", "equal", "falling"])
def test_spending_refuses_looks_that_do_not_rise(looks):
    with pytest.raises(ConfigError, match="mend: give scene counts that rise"):
        spend(looks, 0.05)


@relaxed
@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_gives_the_reference_values(p):
    adjusted = holm({str(i): v for i, v in enumerate(p)})
    assert list(adjusted.values()) == pytest.approx(list(multipletests(p, method="holm")[1]))


@relaxed
@given(st.floats(-3, 5), st.floats(0.1, 0.9), st.floats(0.001, 0.1))
def test_outlook_is_a_chance_that_grows_with_the_evidence(z, seen, alpha):
    assert 0 <= outlook(z, seen, alpha) <= outlook(z + 0.5, seen, alpha) <= 1


@pytest.mark.parametrize(("z", "reached"), [(3.0, 1), (1.0, 0)])
def test_outlook_at_the_end_is_the_answer(z, reached):
    assert outlook(z, 1.0, 0.05) == reached


def test_outlook_agrees_with_playing_on():
    rng = np.random.default_rng(1)
    trend = 1.5 / np.sqrt(0.25) + rng.standard_normal(200_000) / np.sqrt(0.25)  # flat prior, seen a quarter
    final = 1.5 * np.sqrt(0.25) + trend * 0.75 + rng.standard_normal(200_000) * np.sqrt(0.75)
    assert outlook(1.5, 0.25, 0.02) == pytest.approx((final > stats.norm.isf(0.02)).mean(), abs=0.005)


def test_the_further_scenes_of_a_gain_decide_in_four_of_five_tries():
    more = further_scenes_to_show(fixed=14, broken=6, n=200, alpha=0.02)
    rng = np.random.default_rng(2)
    draws = rng.multinomial(200 + more, [0.07, 0.03, 0.9], size=2000)
    assert 0.7 < np.mean([mcnemar(f, b).p_gain <= 0.02 for f, b, _ in draws]) < 0.9


def test_the_further_scenes_of_a_bound_decide_in_four_of_five_tries():
    more = further_scenes_to_bound(fixed=6, broken=6, n=200, alpha=0.02, margin=0.05)
    rng = np.random.default_rng(2)
    draws = rng.multinomial(200 + more, [0.03, 0.03, 0.94], size=600)
    assert 0.7 < np.mean([loss_upper(int(f), int(b), 200 + more, 0.02) < 0.05 for f, b, _ in draws]) < 0.9


def test_no_number_of_scenes_shows_a_gain_that_is_not_there():
    assert further_scenes_to_show(fixed=5, broken=5, n=100, alpha=0.05) is None
    assert further_scenes_to_bound(fixed=0, broken=10, n=100, alpha=0.05, margin=0.05) is None
