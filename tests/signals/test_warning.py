"""The early warning: higher where the two signals are higher, unknown until both are known."""

import numpy as np
import pytest
from scipy.optimize import minimize

from pipeline.signals.neighbours import Neighbours
from pipeline.signals.tick import Signals
from pipeline.signals.warning import WEIGHTS, Running, fit, warning
from pipeline.signals.windows import first_lasting, last_until, mean_until


def test_more_distance_and_more_revision_mean_more_risk():
    low, high = ({"distance": np.array([d]), "revision": np.array([r])} for d, r in ((2.0, 0.02), (6.0, 0.2)))
    assert 0 <= warning(low)[0] < 0.5 < warning(high)[0] <= 1


def test_it_rests_on_the_mean_so_far_and_on_nothing_of_others(observations):
    seen = observations(40)
    known = Neighbours.among(seen.state.astype(np.float32), seen.environment.astype(np.float32))
    signals, two, action = Signals(2, known), observations(2, seed=5), np.zeros((2, 5))
    first = signals.tick(two, action, {}, np.arange(2), np.full((2, 5), np.nan))
    assert np.isnan(first["warning"]).all(), "nothing was planned for the first tick"
    told = [signals.tick(two, action, {}, np.arange(2), np.array([[r] * 5, [0.0] * 5]))["warning"] for r in (0.1, 0.2)]
    assert told[1][0] > told[0][0]
    assert told[1][1] == pytest.approx(told[0][1])


def test_a_running_mean_leaves_out_what_is_not_known():
    running, ids = Running(2), np.arange(2)
    for values in ([1.0, np.nan], [np.nan, np.nan], [3.0, np.inf]):
        means = running.tick({"a": np.array(values)}, ids)["a"]
    assert means[0] == 2 and np.isnan(means[1])


def test_the_fit_is_the_maximum_of_the_penalised_likelihood():
    rng = np.random.default_rng(1)
    x = rng.normal(size=(400, 2))
    y = (rng.random(400) < 1 / (1 + np.exp(1 - x @ [2.0, -1.0]))).astype(float)
    x[7] = np.nan  # an attempt of which nothing is known
    keep = np.arange(400) != 7

    def loss(beta):
        z = beta[0] + x[keep] @ beta[1:]
        return np.logaddexp(0, z).sum() - (y[keep] * z).sum() + 0.5 * (beta[1:] ** 2).sum()

    bias, weights = fit(x, y)
    assert [bias, *weights] == pytest.approx(minimize(loss, np.zeros(3), tol=1e-10).x, abs=1e-4)
    assert len(WEIGHTS) == 2


def test_windows_end_with_the_attempt_and_leave_out_what_is_not_known():
    values = np.array([np.nan, 1.0, 3.0, 5.0])
    assert (mean_until(values, 3), mean_until(values, 99), last_until(values, 3)) == (2.0, 3.0, 3.0)
    assert np.isnan(mean_until(values, 1)) and np.isnan(last_until(values, 1))


def test_a_rule_speaks_when_a_signal_has_lasted():
    values = np.array([0.0, 2, 2, 0, 2, np.nan, 2, 2])
    assert first_lasting(values, 1.0, 3) == 7
    assert first_lasting(values, 1.0) == 1
    assert first_lasting(values, 3.0) is None
