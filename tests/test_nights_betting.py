"""Bets on paired outcomes: the numbers by scipy, and the promise by exact enumeration of every path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from pipeline.errors import ConfigError
from pipeline.statistics.betting import FRACTIONS, log_bound, log_gain, loss_upper_by_bets

relaxed = settings(deadline=None, max_examples=40)
tables = st.tuples(st.integers(0, 60), st.integers(0, 60), st.integers(0, 300)).map(
    lambda t: (t[0], t[1], sum(t) + 1))  # fixed, broken, scenes


@pytest.mark.parametrize(("fixed", "broken"), [(0, 0), (5, 1), (30, 10), (2, 9), (100, 20)])
def test_the_bet_on_a_gain_is_the_mixture_that_it_says(fixed, broken):
    by_hand = integrate.quad(lambda q: 2 * (2 * q) ** fixed * (2 * (1 - q)) ** broken, 0.5, 1)[0]
    assert np.exp(log_gain(fixed, broken)) == pytest.approx(by_hand)
    posterior = stats.beta(fixed + 1, broken + 1)
    ways = stats.binom.pmf(fixed, fixed + broken, 0.5)
    assert np.exp(log_gain(fixed, broken)) == pytest.approx(2 * posterior.sf(0.5) / (fixed + broken + 1) / ways)


@pytest.mark.parametrize(("fixed", "broken", "n", "margin"), [(3, 2, 50, 0.05), (0, 0, 40, 0.1), (9, 20, 90, 0.3)])
def test_the_bet_on_a_bound_is_the_mean_of_its_products(fixed, broken, n, margin):
    x = np.r_[-np.ones(fixed), np.ones(broken), np.zeros(n - fixed - broken)]
    products = [np.prod(1 + share / (1 - margin) * (margin - x)) for share in FRACTIONS]
    assert np.exp(log_bound(fixed, broken, n, margin)) == pytest.approx(np.mean(products))


def ever(capital: np.ndarray, p_fixed: float, p_broken: float, alpha: float) -> float:
    """Chance that a capital, given as [scene, fixed, broken], ever reaches 1 / alpha: every path is added up."""
    scenes = capital.shape[0] - 1
    alive, reached = np.zeros((scenes + 1, scenes + 1)), 0.0
    alive[0, 0] = 1
    for n in range(1, scenes + 1):
        grown = alive * (1 - p_fixed - p_broken)
        grown[1:] += alive[:-1] * p_fixed
        grown[:, 1:] += alive[:, :-1] * p_broken
        there = capital[n] >= 1 / alpha
        reached += grown[there].sum()
        alive = np.where(there, 0, grown)
    return reached


def grid(scenes: int, of) -> np.ndarray:
    """A capital for every scene and count."""
    counts = np.arange(scenes + 1)
    with np.errstate(all="ignore"):
        return np.stack([np.nan_to_num(np.exp(of(counts[:, None], counts[None, :], n))) for n in range(scenes + 1)])


@pytest.mark.parametrize("alpha", [0.2, 0.02])
@pytest.mark.parametrize(("fixed", "broken"), [(0.5, 0.5), (0.15, 0.15), (0.1, 0.2), (0.02, 0.02)], ids=str)
def test_a_candidate_that_is_no_better_is_ever_promoted_as_rarely_as_promised(fixed, broken, alpha):
    counts = np.arange(121)
    capital = np.broadcast_to(np.exp(log_gain(counts[:, None], counts[None, :])), (121, 121, 121))
    assert ever(capital, fixed, broken, alpha) <= alpha + 1e-12


@pytest.mark.parametrize("discordant", [0.1, 0.2, 0.5, 0.98])
def test_a_family_that_loses_the_margin_is_ever_bounded_as_rarely_as_promised(discordant):
    margin, alpha = 0.1, 0.05
    capital = grid(120, lambda f, b, n: log_bound(f, b, np.maximum(n, f + b), margin))
    assert ever(capital, (discordant - margin) / 2, (discordant + margin) / 2, alpha) <= alpha + 1e-12


@relaxed
@given(tables, st.sampled_from([0.0003, 0.02, 0.2]), st.floats(0.01, 0.5))
def test_a_bound_lies_below_the_margin_exactly_where_the_claim_has_fallen(table, alpha, margin):
    fixed, broken, n = table
    bound = loss_upper_by_bets(fixed, broken, n, alpha)
    assert (broken - fixed) / n < bound <= 1
    if abs(bound - margin) > 1e-6:
        assert (bound < margin) == (log_bound(fixed, broken, n, margin) >= -np.log(alpha))


@relaxed
@given(tables)
def test_more_evidence_moves_both_capitals_its_way(table):
    fixed, broken, n = table
    assert log_gain(fixed + 1, broken) > log_gain(fixed, broken) - 1e-9 or fixed < broken
    assert log_gain(fixed, broken + 1) < log_gain(fixed, broken) + 1e-9
    assert log_bound(fixed, broken + 1, n + 1, 0.05) < log_bound(fixed, broken, n, 0.05)


def test_impossible_counts_are_refused():
    with pytest.raises(ConfigError, match=r"mend: count discordant scenes with compare\(\)"):
        loss_upper_by_bets(4, 4, 7, 0.05)
