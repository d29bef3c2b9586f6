"""What the nightly test sees, and how soon, beside STEP and the design with a fixed number of scenes."""

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.contingency_tables import mcnemar

from pipeline.errors import ConfigError
from pipeline.statistics.nightly import Limits
from pipeline.statistics.nights import mixed, pair
from pipeline.statistics.power import fixed_power, fixed_size, fixed_whole, nightly_operating
from pipeline.statistics.step import operate, synthesize

ALPHA = 0.09 / 365


@pytest.fixture(scope="module")
def step():
    return synthesize(60, 0.05, every=5)


def test_the_fixed_design_has_the_power_that_counting_every_table_gives():
    power = 0.0
    for m in range(41):
        for fixed in range(m + 1):
            if mcnemar([[0, m - fixed], [fixed, 0]], exact=True).pvalue / 2 <= 0.02 and 2 * fixed > m:
                power += stats.binom.pmf(m, 40, 0.4) * stats.binom.pmf(fixed, m, 0.75)
    assert fixed_power(40, 0.3, 0.1, 0.02) == pytest.approx(power)


def test_the_planned_number_of_scenes_has_the_planned_power():
    n = fixed_size(0.12, 0.02, ALPHA, 0.9)
    assert fixed_power(n, 0.12, 0.02, ALPHA) >= 0.9 > fixed_power(n - 12, 0.12, 0.02, ALPHA)


def test_pairs_have_the_rates_and_the_correlation_that_were_asked_for():
    fixed, broken = pair(0.85, 0.9, 0.3)
    assert 0.85 - broken + fixed == pytest.approx(0.9)
    both = 0.85 - broken
    assert (both - 0.85 * 0.9) / np.sqrt(0.85 * 0.15 * 0.9 * 0.1) == pytest.approx(0.3)


def test_the_nightly_test_stops_early_when_it_is_sure():
    planned = fixed_size(*pair(0.85, 0.9, 0.3), ALPHA, 0.9)
    fixed, broken = pair(0.85, 0.95, 0.3)
    one = mixed(np.ones(1), np.array([fixed]), np.array([broken]))
    three = mixed(np.array([0.5, 0.25, 0.25]), np.full(3, fixed), np.full(3, broken))
    for chances in (one, three):
        tonight = nightly_operating(chances, ALPHA, Limits(0.05, 0.05, 3000), batch=50, nights=400, seed=1)
        assert tonight.rejects > 0.98
        assert tonight.scenes < planned / 2
    assert fixed_whole(planned, three, ALPHA, 0.05, nights=50, seed=1) > 0.95


def test_step_keeps_its_error_at_every_rate_and_stops_early(step):
    for p in (0.02, 0.1, 0.3, 0.5, 0.8, 0.95):
        assert operate(step, p * (1 - p), p * (1 - p), p * p).rejects <= 0.05 * 1.15
    assert operate(step, 0.25, 0.25, 0.25).rejects > 0.049, "the whole error is used at a rate of one half"
    better = operate(step, 0.4, 0.05, 0.5)
    assert better.rejects > 0.95 and better.scenes < 30


def test_step_is_no_weaker_than_barnards_test_at_the_end_of_its_scenes(step):
    p = stats.barnard_exact([[28, 32], [52, 8]], alternative="less", n=64).pvalue
    assert p < 0.001
    assert step.reject[-1][28, 52] == 1 and step.reject[-1][30, 31] == 0


def test_a_step_plan_without_a_whole_number_of_decisions_is_refused():
    with pytest.raises(ConfigError, match="mend: give a largest number that is a multiple of `every`"):
        synthesize(55, 0.05, every=10)


def test_pairing_pays_where_outcomes_correlate():
    fixed, broken = pair(0.85, 0.95, 0.6)
    one = mixed(np.ones(1), np.array([fixed]), np.array([broken]))
    tonight = nightly_operating(one, 0.01, Limits(0.05, 0.05, 200), batch=10, nights=1500, seed=2)
    unpaired = operate(synthesize(200, 0.01, every=10, points=9), float(fixed), float(broken), 0.85 - float(broken))
    assert tonight.rejects > unpaired.rejects and tonight.scenes < unpaired.scenes
