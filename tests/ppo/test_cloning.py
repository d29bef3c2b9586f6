"""Experts, what they demonstrate, what PPO's networks learn of it, and states before falls."""

import numpy as np
import pytest

from pipeline.errors import ConfigError, PolicyError
from pipeline.locomotion import demonstrations
from pipeline.locomotion.balance import BalanceController
from pipeline.locomotion.before_falls import play_from
from pipeline.locomotion.biped import biped
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.demonstrations import Demonstrations, demonstrate, discounted
from pipeline.locomotion.evaluation import evaluate, zero_action
from pipeline.locomotion.starts import draw_start
from pipeline.locomotion.tasks import LeggedTask, Pushes
from pipeline.locomotion.world import LeggedWorld
from pipeline.ppo.cloning import CloneConfig, clone
from pipeline.ppo.config import Order
from pipeline.ppo.runner import OnnxRunner
from pipeline.ppo.training import Training


@pytest.fixture(scope="module", autouse=True)
def _few_at_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demonstrations, "SIDE_BY_SIDE", 32)
        yield


@pytest.fixture(scope="module")
def body() -> LeggedBody:
    return biped()


@pytest.fixture(scope="module")
def calm(order) -> LeggedTask:
    """Four seconds without blows."""
    return order.task.model_copy(update={"pushes": Pushes(), "seconds": 4.0})


@pytest.fixture(scope="module")
def shown(body, calm) -> Demonstrations:
    return demonstrate(BalanceController(body), body, calm, keep=10, most=32, seed=0, stratum="leaning")


@pytest.fixture(scope="module")
def taught(order, shown, tmp_path_factory) -> tuple[Training, list]:
    roomy = order.model_copy(update={"ppo": order.ppo.model_copy(update={"hidden": (32, 32)})})
    training = Training(roomy, tmp_path_factory.mktemp("taught"))
    return training, clone(training, shown, CloneConfig(epochs=12, batch=128, learning_rate=3e-3), seed=0)


def test_the_balance_controller_stands_where_zero_action_falls(body, calm):
    lengths = [evaluate(act, body, calm, n=24, seed=1).length.mean() for act in (
        BalanceController(body), zero_action(len(body.joints)))]
    assert lengths[0] > 1.5 * lengths[1]


def test_the_balance_controller_leans_against_a_lean(body):
    sensed = np.zeros((2, 39), np.float32)
    sensed[:, 5] = 1.0
    sensed[0, 3], sensed[1, 3] = -0.1, 0.1  # leans forward, backward
    ankle = body.joints.index("left_ankle_pitch")
    forward, backward = BalanceController(body)(sensed)[:, ankle]
    assert forward == -backward > 0
    assert not BalanceController(body)(sensed)[:, body.joints.index("left_hip_roll")].any()


def test_a_robot_without_servos_has_no_balance_controller(body):
    from dataclasses import replace

    with pytest.raises(ConfigError, match="mend: clone a policy of this robot"):
        BalanceController(replace(body, control="torque"))


def test_only_attempts_that_reached_their_end_are_kept(body, shown, calm):
    assert shown.sensed.shape == (10, calm.ticks, 39)
    assert shown.played == 32
    assert 10 * calm.ticks < shown.steps < 32 * calm.ticks
    assert (shown.sensed[:, :, 5] > np.cos(calm.fallen_rad) - 0.1).all()
    assert len(shown.met) > 10 * calm.ticks / 4  # those that fell are met, too
    again = demonstrate(BalanceController(body), body, calm, keep=2, most=1, seed=0, stratum="leaning")
    assert np.array_equal(again.action, shown.action[:2])


def test_an_expert_that_always_falls_is_told_in_one_line(body, order):
    with pytest.raises(PolicyError, match="the expert fell in all of 32 attempts"):
        demonstrate(zero_action(10), body, order.task, keep=1, most=1, seed=0, stratum="thrown")


def test_the_worth_of_a_tick_is_what_comes_discounted_and_unknown_near_the_end():
    reward = np.random.default_rng(0).normal(size=(20, 2))
    worth = discounted(reward, 0.5)
    assert worth[3, 1] == pytest.approx(sum(0.5**k * reward[3 + k, 1] for k in range(17)))
    assert np.isnan(worth[14:]).all()
    assert np.isfinite(worth[:14]).all()


def test_a_clone_does_what_its_expert_does(body, shown, taught, tmp_path):
    training, epochs = taught
    spread = float(shown.action.var(axis=(0, 1)).mean())
    assert epochs[-1].held_out < 0.1 * spread
    assert epochs[-1].actor < epochs[0].actor
    assert epochs[-1].critic < epochs[0].critic
    training.export(tmp_path / "policy.onnx")
    rows = shown.sensed[-1]
    apart = OnnxRunner(tmp_path / "policy.onnx")(rows) - BalanceController(body)(rows)
    assert (apart**2).mean() < 0.1 * spread


def test_what_a_clone_does_hardly_moves_with_what_ppo_meets(taught, shown):
    normaliser = taught[0].env.normaliser
    mean = normaliser.mean.copy()
    normaliser.update(100 * np.ones((4096, 39), np.float32))
    assert np.abs(normaliser.mean - mean).max() < 0.1
    normaliser.mean = mean


def test_a_training_goes_on_from_a_clone_with_a_fresh_optimiser(taught, tmp_path):
    training, _ = taught
    order = training.order.model_copy(update={"goes_on": training.leave_weights(tmp_path / "w.safetensors")})
    begun = Training(order, tmp_path / "ppo", weights=tmp_path / "w.safetensors")
    assert all(np.array_equal(v, training.weights[k]) for k, v in begun.weights.items())
    assert begun.model.policy.optimizer.state_dict()["state"] == {}
    assert np.isfinite([p["reward"] for p in begun.run(save_every=10**6).curve]).all()


def test_a_clone_is_made_before_a_training_begins_and_of_its_own_robot(shown, straight, order, tmp_path):
    with pytest.raises(PolicyError, match="mend: clone into another folder"):
        clone(straight, shown, CloneConfig(), seed=0)
    walks = Order(body="biped", name="walk", task=order.task.model_copy(update={"stride_s": 0.7}), ppo=order.ppo)
    with pytest.raises(PolicyError, match="senses 39 values, the robot 41"):
        clone(Training(walks, tmp_path), shown, CloneConfig(), seed=0)


def test_robots_are_put_back_where_they_were(body, calm):
    world = LeggedWorld(body, calm, 3)
    ids = np.arange(3)
    world.restart(ids, [draw_start(calm, body, "leaning", k) for k in range(3)])
    for _ in range(20):
        world.act(np.full((3, 10), 0.1))
    there = world.as_starts(ids)
    other = LeggedWorld(body, calm, 3)
    other.restart(ids, there)
    assert np.allclose(other.observe()[:, :26], world.observe()[:, :26], atol=1e-6)
    for before, after in zip(there, other.as_starts(ids), strict=True):
        assert after.height_m == before.height_m
        assert np.array_equal(after.velocity, before.velocity)


def test_a_state_before_a_fall_leads_to_the_fall_again(body, calm):
    starts = [draw_start(calm, body, "thrown", k) for k in range(12)]
    played = play_from(zero_action(10), body, calm, starts, before_s=0.3)
    assert len(played.before) == (~played.full).sum() > 6
    late = [i for i in played.before if played.length[i] >= 15]
    again = play_from(zero_action(10), body, calm, [played.before[i] for i in late])
    assert np.abs(again.length - 15).max() <= 2  # the solver's last forces are not part of a start
