"""Evaluation: who has not fallen, and who also went as fast as asked."""

import numpy as np

from pipeline.locomotion import evaluation
from pipeline.locomotion.evaluation import (
    OFF_M_S,
    SETTLED_S,
    evaluate,
    evaluation_seed,
    random_action,
    zero_action,
)
from pipeline.locomotion.starts import draw_start
from pipeline.locomotion.tasks import STAND, WALK, Pushes, Starts

STILL = STAND.model_copy(update={"starts": {"home": Starts()}, "pushes": Pushes(), "seconds": 3.0})
"""Zero action does not fall within these 3 s."""


def test_who_is_full_follows_only_if_the_speed_was_near_that_asked_for(body):
    pace = evaluate(zero_action(10), body, STILL, n=1).mean[0, 0]  # it begins to topple, slowly
    for off, follows in ((0.0, True), (0.9 * OFF_M_S, True), (1.1 * OFF_M_S, False), (-1.1 * OFF_M_S, False)):
        done = evaluate(zero_action(10), body, STILL.asking(pace + off), n=2)
        assert done.full.all()
        assert done.asked[0].tolist() == [pace + off, 0, 0]
        assert done.follows.tolist() == [follows] * 2


def test_whoever_falls_before_speeds_are_taken_follows_nothing(body):
    done = evaluate(random_action(10, 0), body, WALK.asking(0.5), n=20)
    early = done.length <= SETTLED_S * WALK.control_hz
    assert early.any()
    assert np.isnan(done.mean[early]).all()
    assert np.isfinite(done.mean[~early]).all()
    assert not done.follows.any()


def test_the_speed_told_is_the_way_gone_by_the_time_it_took(body):
    """Pushed hard once, just before speeds are taken, the robot slides and topples: its mean speed is not 0."""
    pushes = Pushes(speed_m_s=1.5, every_s=(SETTLED_S, SETTLED_S))
    task = STILL.model_copy(update={"pushes": pushes, "seconds": SETTLED_S + 0.3})
    done = evaluate(zero_action(10), body, task.asking(0.0), n=12, seed=1)
    blows = np.array([draw_start(task, body, "home", seed).blows[0, 1:] for seed in
                      (evaluation_seed(1, k) for k in range(12))])
    going = done.length > SETTLED_S * task.control_hz + 5
    assert going.sum() > 6
    forward, left = done.mean[going, 0], done.mean[going, 1]
    assert np.corrcoef(forward, blows[going, 0])[0, 1] > 0.9
    assert np.corrcoef(left, blows[going, 1])[0, 1] > 0.9
    assert (np.abs(forward) > OFF_M_S).any()


def test_a_command_for_all_leaves_the_starts_as_they_are(body):
    drawn, asked = (draw_start(task, body, "standing", 5) for task in (WALK, WALK.asking(0.3, 0.1, -0.2)))
    assert asked.command.tolist() == [0.3, 0.1, -0.2]
    for name in ("quaternion", "velocity", "bend", "blows"):
        assert np.array_equal(getattr(drawn, name), getattr(asked, name))


def test_steps_are_counted_where_feet_are_lifted_and_none_where_they_stay(body, monkeypatch):
    monkeypatch.setattr(evaluation, "SETTLED_S", 0.1)
    task = STILL.model_copy(update={"seconds": 0.7})
    bend = np.array([[0, -0.8, 1.6, -0.8, 0]])  # of one leg: it lifts its foot straight up

    def marching(period_ticks: int):
        ticks = iter(range(10**6))

        def act(sensed):
            left = next(ticks) % period_ticks < period_ticks / 2
            return np.repeat(np.hstack([bend * left, bend * (not left)]), len(sensed), axis=0)

        return act

    standing = evaluate(zero_action(10), body, task, n=1)
    assert (standing.steps_hz[0], standing.airborne[0]) == (0, 0)
    slow, fast = (evaluate(marching(ticks), body, task, n=1) for ticks in (20, 10))
    assert slow.full.all()
    assert fast.full.all()
    assert 2 < slow.steps_hz[0] < fast.steps_hz[0] < 9  # 2.5 and 5 were asked of each foot
