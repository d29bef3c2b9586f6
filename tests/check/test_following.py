"""The lag between two signals, recovered whatever it is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.check.following import best_lag, correlation, resample


def wander(rng: np.random.Generator, n: int, d: int) -> np.ndarray:
    """A smooth rate of change, as that of a joint."""
    rough = rng.standard_normal((n + 8, d))
    return np.stack([np.convolve(column, np.hanning(9), "valid") for column in rough.T], axis=1)[:n]


@settings(max_examples=40, deadline=None)
@given(lag=st.integers(-12, 12), n=st.integers(60, 200), d=st.integers(1, 7), noise=st.floats(0, 0.3),
       scale=st.floats(0.01, 100), seed=st.integers(0, 1000))
def test_a_shift_is_recovered_whatever_scale_and_noise(lag, n, d, noise, scale, seed):
    rng = np.random.default_rng(seed)
    whole = wander(rng, n + 24, d)
    leader, follower = whole[12:12 + n], scale * (whole[12 - lag:12 - lag + n] + noise * rng.standard_normal((n, d)))
    fit = best_lag(leader, follower, 0.05, allowed_s=(0, 0.4))
    assert fit is not None
    assert fit.lag_s == pytest.approx(lag * 0.05, abs=0.05)


@settings(max_examples=25, deadline=None)
@given(fraction=st.floats(-0.5, 0.5), seed=st.integers(0, 1000))
def test_the_lag_is_told_finer_than_the_clock(fraction, seed):
    rng = np.random.default_rng(seed)
    fine = wander(rng, 4000, 2)
    smooth = np.stack([np.convolve(c, np.hanning(61), "same") for c in fine.T], axis=1)
    at = np.arange(200, 3800, 20)
    fit = best_lag(smooth[at], smooth[at - round(20 * (3 + fraction))], 0.05, allowed_s=(0, 0.4))
    assert fit is not None and fit.lag_s == pytest.approx((3 + fraction) * 0.05, abs=0.015)


def test_nothing_is_told_of_what_stands_still_or_is_too_short():
    still, moving = np.zeros((50, 2)), wander(np.random.default_rng(0), 50, 2)
    assert best_lag(still, moving, 0.05, allowed_s=(0, 1)) is None
    assert best_lag(moving[:10], moving[:10], 0.05, allowed_s=(0, 1)) is None


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30))
def test_resampling_at_the_own_stamps_changes_nothing(values):
    rows, stamps = np.array(values)[:, None], np.arange(len(values), dtype=float)
    assert np.array_equal(resample(stamps, rows, stamps), rows)


@given(st.lists(st.floats(-10, 10), min_size=3, max_size=20), st.floats(0.1, 10), st.floats(-10, 10))
def test_correlation_ignores_scale_and_offset(values, scale, offset):
    one = np.array(values)
    if one.std() > 1e-3:
        assert correlation(one, scale * one + offset) == pytest.approx(1, abs=1e-6)
        assert correlation(one, -one) == pytest.approx(-1, abs=1e-6)
