"""Variants: a recorded attempt replayed, and carried over to other starts."""

import numpy as np
import pytest

from pipeline.errors import SimulationError
from pipeline.simulation.rollout import rollout
from pipeline.simulation.variants import ARRIVED_M, SPEED_M, TURN_RAD, Playback, path_of, retarget, survival
from pipeline.simulation.world import HOME


def play(world, actions, *, paced=True):
    policy = Playback(actions, paced=paced)
    policy.reset(world.n)
    return rollout(world, policy).success


def test_commands_played_by_the_clock_repeat_the_attempt(make_world, demonstrations):
    scenes, traces = demonstrations
    assert play(make_world(scenes), [t.action for t in traces], paced=False).all()


def gaps_at_closing(world, actions, *, paced):
    """Distance of the tool to its command when each attempt is first told to close [m], and who succeeded."""
    gaps, policy = np.full(world.n, np.nan), Playback(actions, paced=paced)

    def watch(tick, ids, seen, action):
        now = np.isnan(gaps[ids]) & (action[:, 4] < 0.04)
        gaps[ids[now]] = np.linalg.norm(seen.state[now, 7:10] - seen.state[now, 11:14], axis=1)
        return np.zeros(len(ids), bool)

    policy.reset(world.n)
    return gaps, rollout(world, policy, watch=watch).success


def test_paced_replays_close_where_the_demonstration_did_and_not_when(make_world, demonstrations):
    scenes, traces = demonstrations
    actions, slow = [t.action for t in traces], {"kp": 0.6, "damping": 1.5, "delay": 3, "frictionloss": 2.5}
    by_the_clock, _ = gaps_at_closing(make_world(scenes, **slow), actions, paced=False)
    paced, success = gaps_at_closing(make_world(scenes, **slow), actions, paced=True)
    assert (paced < ARRIVED_M).all()
    assert (by_the_clock > ARRIVED_M).any()
    assert success.sum() >= 10


def test_a_demonstration_carried_over_reaches_starts_it_has_never_seen(make_world, starts, demonstrations):
    _, traces = demonstrations
    scenes = starts(24, first=100)
    world, actions = make_world(scenes), []
    seen = world.observe(np.arange(24)).environment
    for i in range(24):
        path = path_of(traces[i % len(traces)].frames(), f"demonstration {i}")
        actions.append(retarget(path, HOME, seen[i, [0, 1, 3]], seen[i, 4:6]))
    assert play(world, actions).sum() >= 22


def test_a_path_carried_to_its_own_start_is_the_path(demonstrations):
    for trace in demonstrations[1]:
        path = path_of(trace.frames(), "demonstration")
        actions = retarget(path, path.pose[0], path.object, path.target)
        assert np.allclose(actions[:, :4].sum(axis=0), path.pose[-1] - path.pose[0], atol=1e-6)
        assert (np.linalg.norm(actions[:, :3], axis=1) <= SPEED_M + 1e-9).all()
        assert (np.abs(actions[:, 3]) <= TURN_RAD + 1e-9).all()


def test_an_attempt_that_never_grasps_is_left_out_by_name(make_world, starts, demonstrations):
    frames = demonstrations[1][0].frames()
    frames.action[:, 4] = 0.08
    with pytest.raises(SimulationError, match=r"at:   episode 7(.|\n)*mend: leave it out of retargeting"):
        path_of(frames, "episode 7")


def test_survival_is_the_share_of_each_demonstrations_variants():
    assert survival(["a", "b", "a", "a"], np.array([True, False, False, True])) == {"a": pytest.approx(2 / 3), "b": 0.0}
