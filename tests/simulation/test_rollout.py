"""Rollout and tracer: finished attempts leave the engine, and what is kept is what happened."""

import numpy as np
import pytest

from pipeline.frames import JOINTS
from pipeline.simulation.expert import Expert
from pipeline.simulation.rollout import rollout
from pipeline.simulation.world import LIMITS


class Counting(Expert):
    """The expert, and how many attempts it was asked about at each tick."""

    def act(self, observation, ids):
        self.asked = [*getattr(self, "asked", []), len(ids)]
        return super().act(observation, ids)


def test_finished_attempts_leave_the_engine(make_world, starts):
    world, policy = make_world(starts(10)), Counting()
    policy.reset(world.n)
    result = rollout(world, policy)
    assert result.success.all()
    assert (world.command.ticks == result.ticks).all()
    assert policy.asked == [int((result.ticks > tick).sum()) for tick in range(result.ticks.max())]
    assert result.ticks.max() < world.task.ticks


def test_only_the_named_attempts_run_and_the_horizon_ends_them(make_world, starts):
    world, policy = make_world(starts(4)), Expert()
    policy.reset(world.n)
    result = rollout(world, policy, ids=np.array([1, 3]), horizon=7)
    assert result.ticks.tolist() == [0, 7, 0, 7]
    assert not result.success.any()


def test_a_watch_ends_attempts_when_it_says_so(make_world, starts):
    world, policy = make_world(starts(4)), Expert()
    policy.reset(world.n)
    result = rollout(world, policy, watch=lambda tick, ids, seen, action: ids == tick)
    assert result.ticks.tolist() == [1, 2, 3, 4]


def test_attempts_can_go_on_after_their_success(make_world, starts):
    world, policy = make_world(starts(2)), Expert()
    policy.reset(world.n)
    result = rollout(world, policy, until_success=False)
    assert (result.ticks == world.task.ticks).all()
    assert result.success.all()


def test_reward_curves_are_means_over_the_attempts_still_running(make_world, starts):
    world, policy = make_world(starts(6)), Expert()
    policy.reset(world.n)
    result = rollout(world, policy, with_rewards=True)
    last = result.ticks.max()
    for curve in result.rewards.values():
        assert np.isfinite(curve[:last]).all()
        assert np.isnan(curve[last:]).all()
    assert result.rewards["success"][last - 1] == world.task.weights["success"]


def test_a_trace_tells_what_was_seen_sent_and_reached(demonstrations):
    scenes, traces = demonstrations
    for scene, trace in zip(scenes, traces, strict=True):
        frames = trace.frames().check("trace")
        assert len(frames) == len(trace) == len(trace.phase)
        assert trace.environment[0, :2] == pytest.approx(scene.object_xy_m)
        moved = np.diff(trace.state[:, 11:15], axis=0)
        assert np.allclose(moved, np.clip(trace.action[:-1, :4], -LIMITS, LIMITS), atol=1e-9)
        assert np.allclose(trace.joint_action[:-1, 6], trace.state[1:, 15])
        assert trace.joint_effort[0].max() == 0
        assert (np.abs(trace.joint_effort[:, :3]) <= 30).all()


def test_link_poses_are_named_and_move_with_the_joints(demonstrations):
    for trace in demonstrations[1]:
        cube = trace.links.index("object")
        assert "target" not in trace.links
        assert trace.link_poses[0, cube, :2] == pytest.approx(trace.environment[0, :2])
        assert trace.link_poses[:, cube, 2].max() > 0.05  # it was carried
        assert np.allclose(np.linalg.norm(trace.link_poses[..., 3:], axis=-1), 1)
        assert np.ptp(trace.link_poses[:, trace.links.index("base_link")]) == pytest.approx(
            np.ptp(trace.link_poses[0, trace.links.index("base_link")]))


def test_speeds_are_the_change_of_what_is_measured(demonstrations):
    trace = demonstrations[1][0]
    change = np.diff(trace.state[:, :len(JOINTS)], axis=0) * trace.hz
    middle = (trace.joint_velocity[:-1, :6] + trace.joint_velocity[1:, :6]) / 2
    assert np.corrcoef(change.ravel(), middle.ravel())[0, 1] > 0.95
