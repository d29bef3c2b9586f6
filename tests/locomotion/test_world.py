"""Legged worlds: restored to the bit, pushed as drawn, judged as told; and the attempts that begin anew in them."""

import numpy as np
import pytest

from pipeline.errors import SimulationError
from pipeline.locomotion.attempts import Attempts
from pipeline.locomotion.evaluation import evaluate, random_action, zero_action
from pipeline.locomotion.starts import draw_start
from pipeline.locomotion.tasks import STAND, WALK, Pushes, Starts
from pipeline.locomotion.world import LeggedWorld

STILL = STAND.model_copy(update={"starts": {"home": Starts()}, "pushes": Pushes()})


def actions(ticks: int, n: int) -> np.ndarray:
    return np.random.default_rng(5).uniform(-0.3, 0.3, (ticks, n, 10))


def played(attempts: Attempts, ticks: np.ndarray) -> list[tuple[bytes, ...]]:
    found = []
    for action in ticks:
        tick = attempts.step(action)
        found.append((tick.observation.tobytes(), tick.reward.tobytes(), tick.fallen.tobytes(), tick.last.tobytes()))
    return found


@pytest.mark.parametrize("task", [STAND, WALK], ids=["stand", "walk"])
def test_attempts_go_on_bit_for_bit_in_another_world(body, task):
    n, path = 6, actions(150, 6)
    first = Attempts(body, task, n, seed=1)
    first.begin()
    played(first, path[:70])
    other = Attempts(body, task, n, seed=1, threads=2)
    other.load(first.save())
    assert played(first, path[70:]) == played(other, path[70:])
    assert first.begun.sum() > n  # some fell and began anew after the restore, so that starts go on, too


def test_a_state_of_another_number_of_robots_is_refused(body):
    with pytest.raises(SimulationError, match="mend: restore with the body, task and number that were saved"):
        LeggedWorld(body, STAND, 3).load(LeggedWorld(body, STAND, 2).save())


def test_restarting_one_attempt_leaves_the_others_alone(body):
    starts = [draw_start(STAND, body, "leaning", k) for k in range(3)]
    one, other = LeggedWorld(body, STAND, 3), LeggedWorld(body, STAND, 3)
    for world in (one, other):
        world.restart(np.arange(3), starts)
    for k, action in enumerate(actions(20, 3)):
        for world in (one, other):
            world.act(action)
        if k == 10:
            one.restart(np.array([1]), [starts[0]])
    assert np.array_equal(one.observe()[[0, 2]], other.observe()[[0, 2]])
    assert not np.array_equal(one.observe()[1], other.observe()[1])


def test_starts_follow_from_the_seed_and_differ_from_place_to_place(body):
    first, again, other = (Attempts(body, STAND, 4, seed=seed).begin() for seed in (7, 7, 8))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert len(np.unique(first, axis=0)) == 4


def test_a_blow_changes_the_speed_over_ground_by_what_was_drawn(body):
    task = STILL.model_copy(update={"pushes": Pushes(speed_m_s=1.0, every_s=(0.2, 0.2))})
    start = draw_start(task, body, "home", 3)
    tick, *blow = start.blows[0]
    pushed, left_alone = LeggedWorld(body, task, 1), LeggedWorld(body, STILL, 1)
    pushed.restart(np.array([0]), [start])
    left_alone.restart(np.array([0]), [draw_start(STILL, body, "home", 3)])
    for _ in range(int(tick)):
        pushed.act(np.zeros((1, 10)))
        left_alone.act(np.zeros((1, 10)))
    assert np.array_equal(pushed.observe(), left_alone.observe())
    for world in (pushed, left_alone):
        world.act(np.zeros((1, 10)))
    apart = (pushed.motion().velocity - left_alone.motion().velocity)[0, :2]
    assert apart @ blow > 0.5 * (np.linalg.norm(blow) ** 2)  # the feet have braked it by some within the tick


def test_zero_action_stands_at_home_and_falls_from_every_start_of_the_task(body):
    assert evaluate(zero_action(10), body, STILL.model_copy(update={"seconds": 2.0}), n=2).full.all()
    assert evaluate(zero_action(10), body, STAND, n=100).full.mean() <= 0.02
    assert not evaluate(random_action(10, 0), body, STAND, n=30).full.any()


def test_a_robot_that_lies_down_has_fallen_and_a_standing_one_has_not(body):
    world = LeggedWorld(body, STILL, 2)
    lying = draw_start(STILL, body, "home", 0)
    lying.quaternion[:] = [np.sqrt(0.5), np.sqrt(0.5), 0, 0]
    world.restart(np.arange(2), [draw_start(STILL, body, "home", 0), lying])
    assert world.fallen(world.motion()).tolist() == [False, True]


def test_a_robot_whose_physics_diverged_has_fallen(body):
    world = LeggedWorld(body, STILL, 1)
    world.restart(np.array([0]), [draw_start(STILL, body, "home", 0)])
    world.batch.bind("qpos")[0, 3:7] = np.nan
    assert world.fallen(world.motion()).all()


def test_the_walking_robot_is_asked_for_what_the_task_says(body):
    world = LeggedWorld(body, WALK, 20)
    world.restart(np.arange(20), [draw_start(WALK, body, "standing", k) for k in range(20)])
    (low, high), *_ = WALK.command
    assert low <= world.command[:, 0].min() < world.command[:, 0].max() <= high
    assert np.array_equal(world.observe()[:, -5:-2], world.command.astype(np.float32))


def test_feet_bump_into_each_other_only_where_the_task_says_so(body):
    """In the air, both hips roll inwards."""
    nearest = {}
    for solid in (True, False):
        task = STILL.model_copy(update={"solid_feet": solid})
        world = LeggedWorld(body, task, 1)
        world.restart(np.array([0]), [draw_start(task, body, "home", 0)])
        world.batch.bind("qpos")[0, 2] += 1.0
        places = [world.model.geom(foot).id for foot in body.feet]
        action = np.zeros((1, 10))
        action[0, [0, 5]] = -1.0, 1.0
        apart = []
        for _ in range(15):
            world.act(action)
            left, right = world.batch.bind("geom_xpos").reshape(1, -1, 3)[0, places, 1]
            apart.append(left - right)
        nearest[solid] = min(apart)
    assert nearest[True] > 0.02  # pressed together by both hips, feet 0.07 m wide give a little
    assert nearest[False] < -0.05
