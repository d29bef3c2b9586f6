"""Legged robots under commands of speed: the same bits as without a hierarchy, courses, and plans in simulation."""

import numpy as np
import pytest

from pipeline.control.config import LEGGED_SAMPLING, CourseConfig, HierarchyConfig
from pipeline.control.legged import LeggedSensed, legged_plant
from pipeline.control.legged_model import LeggedModel
from pipeline.control.legged_parts import Trained, Waypoints
from pipeline.control.sampling import Planner
from pipeline.control.table import legged_hierarchy
from pipeline.errors import ConfigError, PolicyError
from pipeline.locomotion.evaluation import evaluation_seed
from pipeline.locomotion.starts import draw_start
from pipeline.locomotion.tasks import STAND, WALK
from pipeline.locomotion.world import LeggedWorld
from pipeline.ppo.runner import OnnxRunner

SMALL = LEGGED_SAMPLING.model_copy(update={"samples": 3, "horizon_s": 0.1})


def over(walker, **words):
    return HierarchyConfig.model_validate({
        "robot": "biped", "upper": "profile", "lower": "policy", "upper_hz": 10, "lower_hz": 50,
        "policy": str(walker), "sampling": SMALL, "course": CourseConfig(profile=((0, 0.5),), turn_rad_s=0), **words})


def sensed_at(position, heading):
    """What robots sense that stand somewhere."""
    n = len(position)
    return LeggedSensed(np.zeros((n, 41), np.float32), np.array(position, float), np.array(heading, float), {})


def test_a_policy_walks_the_same_bits_above_the_engine_as_on_its_own_clock(body, walker):
    plant = legged_plant(body, WALK, 3, seed=2)
    hierarchy = legged_hierarchy(over(walker), plant)
    world = LeggedWorld(body, WALK, 3)
    world.restart(np.arange(3), [draw_start(WALK, body, "standing", evaluation_seed(2, k)) for k in range(3)])
    world.command[:] = [0.5, 0.0, 0.0]
    policy = OnnxRunner(walker)
    for _ in range(20):
        action = policy(world.observe())
        assert np.array_equal(hierarchy.tick(), action)
        world.act(action)
    assert np.array_equal(plant.world.batch.state, world.batch.state)


def test_a_policy_is_not_asked_for_what_it_never_learned(body, walker):
    plant = legged_plant(body, WALK, 1, seed=0)
    lower, sensed = Trained(walker, plant), plant.sense()
    fast, turning = lower.act(np.array([[9.0, 0, 0]]), sensed), lower.act(np.array([[0.8, 1.0, 2.0]]), sensed)
    assert np.array_equal(fast, lower.act(np.array([[0.8, 0, 0]]), sensed))
    assert np.array_equal(fast, turning)  # WALK asks for no turn and no step aside


def test_a_policy_of_another_robot_is_refused(body, walker):
    with pytest.raises(PolicyError, match=r"reads 41 values .*\n.*\n  mend: give a policy of this body and task"):
        Trained(walker, legged_plant(body, STAND, 1, seed=0))  # no clock of a gait, two values less


def test_a_policy_that_is_not_named_is_missed(body, walker):
    with pytest.raises(ConfigError, match="mend: name an ONNX file; hardcase rl train --body biped --task walk"):
        legged_hierarchy(over(walker, policy=None), legged_plant(body, WALK, 1, seed=0))


@pytest.mark.parametrize("words", [{}, {"lower": "mpc"}, {"lower": "zero", "upper": "waypoints"}],
                         ids=["policy", "mpc", "waypoints"])
def test_what_was_saved_goes_on_bit_for_bit(body, walker, words):
    hierarchy, again = (legged_hierarchy(over(walker, **words), legged_plant(body, WALK, 2, seed=0)) for _ in range(2))
    for _ in range(6):
        hierarchy.tick()
    again.load(hierarchy.save())
    for _ in range(6):
        assert np.array_equal(hierarchy.tick(), again.tick())
    assert np.array_equal(hierarchy.plant.save()["state"], again.plant.save()["state"])


def test_waypoints_are_reached_in_turn_and_lead_forward_aside_or_round():
    course = CourseConfig(waypoints=((1.0, 0.0), (1.0, 1.0)), speed_m_s=0.5, turn_rad_s=0.4)
    turns, sidles = (Waypoints(course, 1, turns=turns) for turns in (True, False))
    for part in (turns, sidles):
        assert part.command(sensed_at([[2.0, 3.0]], [0.0]), 0.0)[0] == pytest.approx([0.5, 0.0, 0.0])
    there = sensed_at([[2.95, 3.0]], [0.0])  # next to the first, which lies 1 m ahead of the beginning
    forward, left, turn = turns.command(there, 1.0)[0]
    assert (forward, left, turn) == pytest.approx((0.5 * np.cos(np.arctan2(1, 0.05)), 0.0, 0.4))
    forward, left, turn = sidles.command(there, 1.0)[0]
    assert left > 0.49 and turn == 0.0
    assert sidles.command(sensed_at([[3.0, 4.0]], [0.3]), 2.0)[0].tolist() == [0.0, 0.0, 0.0]
    assert sidles.reached.tolist() == [2.0]


def test_a_plan_costs_what_the_task_does_not_reward(body):
    plant = legged_plant(body, STAND, 2, seed=0, stratum="leaning")
    model = LeggedModel(plant, SMALL)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.2, 0.2, (2, 3, SMALL.steps, 10))
    sensed, command = plant.sense(), np.zeros((2, 3))
    costs = model.costs(sensed, command, actions)
    reward = np.zeros(2)
    for step in range(SMALL.steps):
        plant.act(actions[:, 1, step], 4)
        reward += np.sum(list(plant.world.rewards(plant.motion()).values()), axis=0)
    assert costs[:, 1] == pytest.approx(-reward)
    assert np.array_equal(costs, model.costs(sensed, command, actions))  # nothing is left from the time before


def test_a_plan_for_a_leaning_biped_is_cheaper_than_doing_nothing(body):
    plant = legged_plant(body, STAND, 2, seed=0, stratum="leaning")
    sampling = LEGGED_SAMPLING.model_copy(update={"horizon_s": 0.3})
    model, command = LeggedModel(plant, sampling), np.zeros((2, 3))
    planner = Planner(sampling, plant.rest(), model.low, model.high, seed=0)
    sensed, costs = plant.sense(), []
    for _ in range(3):
        planner.better(lambda actions: costs.append(model.costs(sensed, command, actions)) or costs[-1])
    nothing = costs[0][:, 0]
    assert (costs[-1].min(axis=1) < nothing).all()
