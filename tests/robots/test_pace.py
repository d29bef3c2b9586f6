"""A control clock in wall time, under a clock that the test moves."""

from itertools import pairwise

import pytest

from pipeline.robots.pace import Pace


class Clock:
    """Time that passes only when somebody sleeps or works."""

    def __init__(self):
        self.now_s, self.slept_s = 100.0, []

    def __call__(self):
        return self.now_s

    def sleep(self, seconds):
        self.slept_s.append(round(seconds, 6))
        self.now_s += seconds


@pytest.fixture
def clock():
    return Clock()


def test_ticks_come_at_the_rate_whatever_the_work_takes(clock):
    pace, ticks = Pace(20, now=clock, sleep=clock.sleep), []
    for work_s in (0.001, 0.03, 0.0, 0.049, 0.01):
        clock.now_s += work_s
        pace.wait()
        ticks.append(clock.now_s)
    assert [b - a for a, b in pairwise(ticks)] == pytest.approx([0.05] * 4)
    assert pace.late == 0


def test_a_late_tick_is_counted_and_not_made_up_for_by_a_burst(clock):
    pace = Pace(20, now=clock, sleep=clock.sleep)
    pace.wait()
    clock.now_s += 1.0
    pace.wait()
    assert pace.late == 1
    before = clock.now_s
    for _ in range(3):
        pace.wait()
    assert clock.now_s - before == pytest.approx(0.15), "every later tick has its whole period"


def test_a_pause_on_purpose_is_no_lateness(clock):
    pace = Pace(20, now=clock, sleep=clock.sleep)
    pace.wait()
    pace.restart()
    clock.now_s += 5.0
    pace.wait()
    pace.wait()
    assert pace.late == 0


def test_speed_shortens_the_wait_and_zero_does_not_wait(clock):
    Pace(20, speed=4, now=clock, sleep=clock.sleep).wait()
    assert clock.slept_s == [0.0125]
    Pace(20, speed=0, now=clock, sleep=clock.sleep).wait()
    assert clock.slept_s == [0.0125]
