"""The arm reaches by either lower part, in physics of its own; plans know nothing of it."""

import numpy as np
import pytest

from pipeline.control.arm import ArmPlant, ArmSensed
from pipeline.control.arm_model import ArmModel, apart
from pipeline.control.config import HierarchyConfig, SamplingConfig
from pipeline.control.reaches import Reach, draw_reaches
from pipeline.control.sampling import Planner
from pipeline.control.table import arm_hierarchy
from schemas.scene import Draw

FAST = SamplingConfig(samples=8, horizon_s=0.2)


def away(plant, seconds, **words):
    """Distances to the goals before and after."""
    hierarchy = arm_hierarchy(HierarchyConfig.model_validate(words), plant)
    before = np.linalg.norm(plant.sense().tool[:, :3] - plant.goals[:, :3], axis=1)
    for _ in range(round(seconds * hierarchy.lower_hz)):
        hierarchy.tick()
    return before, np.linalg.norm(plant.sense().tool[:, :3] - plant.goals[:, :3], axis=1)


def test_kinematics_bring_the_hand_within_a_millimetre_and_zero_action_nowhere(arms):
    before, after = away(arms(False), 1.5, lower="ik")
    assert (before > 0.05).all() and (after < 1e-3).all()
    before, after = away(arms(False), 0.5, lower="zero")
    assert np.allclose(before, after, atol=1e-4)


def test_plans_bring_the_hand_near_without_knowing_kinematics(arms):
    before, after = away(arms(False), 1.0, lower="mpc", sampling=FAST)
    assert (after < 0.5 * before).all()


def test_an_integral_takes_the_error_that_a_payload_leaves(reaches):
    loaded = [Reach(reach.goal, (), 0.5) for reach in reaches[False]]
    sagging = away(ArmPlant(loaded), 2.0, lower="ik")[1]
    assert (sagging > away(ArmPlant(reaches[False]), 2.0, lower="ik")[1] + 1e-3).all()
    assert (away(ArmPlant(loaded), 2.0, lower="ik", integral_1_s=3.0)[1] < 0.5 * sagging).all()


@pytest.mark.parametrize("lower_hz", [50, 200])
def test_a_delay_is_as_long_at_every_rate(reaches, lower_hz):
    late = (Draw(name="delay", unit="tick", value=2.0),)
    plant = ArmPlant([Reach(reaches[False][0].goal, late)])
    rest = plant.sense().joints
    moved = []
    for _ in range(round(0.2 * lower_hz)):
        plant.act(plant.rest() + 0.1, round(plant.clock_hz / lower_hz))
        moved.append(np.abs(plant.sense().joints - rest).max() > 1e-6)
    assert np.argmax(moved) / lower_hz == pytest.approx(0.1)  # two ticks of the control clock of training


def test_goals_are_the_same_whatever_the_physics_and_all_within_reach(reaches):
    assert [r.goal for r in reaches[False]] == [r.goal for r in reaches[True]] != [r.goal for r in draw_reaches(
        3, 6, perturbed=False)]
    assert all(r.payload_kg > 0 and r.draws for r in reaches[True])


def test_a_robot_plans_alike_in_any_company(reaches):
    config = HierarchyConfig(lower="mpc", sampling=FAST)
    alone, among = (arm_hierarchy(config, ArmPlant(some)) for some in (reaches[True][:1], reaches[True]))
    for _ in range(4):
        assert np.array_equal(alone.tick(), among.tick()[:1])


def test_plans_are_tried_on_the_nominal_arm(arms):
    """Same encoders, same costs: whatever the physics of the arms that are planned for."""
    nominal, perturbed = arms(False), arms(True)
    sensed = nominal.sense()
    actions = np.repeat((nominal.rest() + 0.1)[:, None, None], FAST.samples, axis=1).repeat(FAST.steps, axis=2)
    costs = [ArmModel(p.setup.body, p.n, FAST).costs(sensed, p.goals, actions) for p in (nominal, perturbed)]
    assert np.array_equal(*costs) and np.isfinite(costs).all()


def test_a_plan_that_breaks_the_simulation_is_not_chosen(arms):
    plant = arms(False)
    sensed = plant.sense()
    broken = ArmSensed(sensed.joints, np.full_like(sensed.speeds, np.nan), sensed.tool)
    actions, model = np.zeros((3, FAST.samples, FAST.steps, 6)), ArmModel(plant.setup.body, 3, FAST)
    assert np.isinf(model.costs(broken, plant.goals, actions)).all()
    assert np.isfinite(model.costs(sensed, plant.goals, actions)).all()


def test_a_plan_gets_better_and_is_never_exchanged_for_a_worse_one():
    config = SamplingConfig(samples=16, knots=1, horizon_s=0.3, plan_hz=10, noise=0.5)
    low, high = np.full(2, -1.0), np.ones(2)
    planner = Planner(config, np.zeros((2, 2)), low, high, seed=0)
    goal = np.array([0.7, -2.0])  # the second lies beyond the limit

    def costs(actions):
        return ((actions - goal) ** 2).sum(axis=(2, 3))

    seen = []
    for _ in range(40):
        planner.better(costs)
        seen.append(costs(np.stack([planner.at(t) for t in config.step_s * np.arange(config.steps)], axis=1)[:, None]))
    assert (np.diff(np.array(seen)[:, :, 0], axis=0) <= 1e-9).all()
    assert np.allclose(planner.at(0.1), [0.7, -1.0], atol=0.05)


def test_a_plan_is_shifted_by_the_time_that_passed():
    config = SamplingConfig(samples=2, knots=3, horizon_s=0.2, plan_hz=10)
    planner = Planner(config, np.zeros((1, 1)), np.array([-9.0]), np.array([9.0]), seed=0)
    planner.better(lambda actions: np.array([[0.0, 1.0]]))
    planner.knots = np.array([[[1.0], [2.0], [4.0]]])
    assert planner.at(0.05)[0, 0] == pytest.approx(1.5)
    planner.better(lambda actions: np.array([[0.0, 1.0]]))  # the plan itself stays the best
    assert planner.knots[0, :, 0].tolist() == pytest.approx([2.0, 4.0, 4.0])


def test_how_far_a_hand_is_from_what_is_asked():
    down = np.diag([1.0, -1.0, -1.0]).ravel()[None]
    metres, turn = apart(np.array([[0.3, 0.0, 0.1]]), down, np.array([[0.3, 0.04, 0.13, 0.5]]))
    assert (metres[0], turn[0]) == pytest.approx((0.05, 0.5))
