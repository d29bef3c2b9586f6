"""Nothing that a robot must not do reaches it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import RobotError
from pipeline.robots.limits import PATIENCE, Guard, Limits
from pipeline.robots.simulated import ARM, ARM_LIMITS

HOLD = np.array([0.0, 0.0, 0.0, 0.0, 0.04])
number = st.one_of(st.floats(-1, 1), st.floats(allow_nan=True, allow_infinity=True))


def guard(limits=ARM_LIMITS):
    return Guard("arm", ARM, limits, HOLD)


@settings(max_examples=200, deadline=None)
@given(actions=st.lists(st.lists(number, min_size=5, max_size=5), min_size=1, max_size=20))
def test_whatever_is_asked_for_what_is_sent_is_finite_within_range_and_within_a_step(actions):
    stepped = Limits(ARM_LIMITS.low, ARM_LIMITS.high, np.array([np.inf, np.inf, np.inf, np.inf, 0.01]))
    watch, last = guard(stepped), HOLD
    try:
        for action in actions:
            sent = watch.check(np.array(action), HOLD).action
            assert np.isfinite(sent).all()
            assert (sent >= stepped.low).all() and (sent <= stepped.high).all()
            if np.isfinite(action).all():
                assert abs(sent[4] - last[4]) <= 0.01 + 1e-12
            last = sent
    except RobotError as error:
        assert "the robot was stopped" in error.what


def test_a_nan_holds_still_and_the_third_in_a_row_stops_the_robot():
    watch, bad = guard(), np.array([0.01, 0.0, np.nan, 0.0, 0.04])
    for _ in range(PATIENCE - 1):
        held = watch.check(bad, HOLD)
        assert (held.action == HOLD).all() and held.note == "action[2] (dz) is NaN; held still"
    assert watch.check(HOLD + 0.001, HOLD).note == ""
    for _ in range(PATIENCE - 1):
        watch.check(bad, HOLD)
    with pytest.raises(RobotError, match=r"action\[2\] \(dz\) is NaN for 3 ticks; the robot was stopped"):
        watch.check(bad, HOLD)


def test_nothing_is_sent_where_nobody_knows_where_the_robot_is():
    lost = HOLD * np.nan
    for act in (lambda: Guard("arm", ARM, ARM_LIMITS, lost), lambda: guard().check(lost, lost)):
        with pytest.raises(RobotError, match=r"where the robot is to be held is not known[\s\S]*check its encoders"):
            act()


def test_a_wrong_number_of_values_is_refused_with_the_right_names():
    with pytest.raises(RobotError, match=r"action has 4 values, robot 'arm' expects 5[\s\S]*send dx, dy, dz, dyaw, g"):
        guard().check(np.zeros(4), HOLD)


def test_what_was_cut_is_named():
    assert guard().check(np.array([0.5, 0.0, 0.0, -3.0, 0.04]), HOLD).note == "limited dx, dyaw"
