"""A legged robot at work on its twin: recordings, falls, restored states, hard starts, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.browsing.recording import of_recording
from pipeline.check.load import read_recording
from pipeline.check.run import check
from pipeline.errors import ConfigError, PolicyError, RecordingError, SimulationError
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.falls import FallSenses, fall_family, fallen
from pipeline.locomotion.robots import LeggedRobots
from pipeline.locomotion.scenes import hard_scene, legged_scenes, starts_of
from pipeline.locomotion.sensed import sensed
from pipeline.locomotion.tasks import load_legged_task
from pipeline.locomotion.world import LeggedWorld, up_of
from pipeline.ppo.policy import LeggedPolicy
from pipeline.protocols import Observation
from pipeline.recording import read_episode
from pipeline.recording.read import read_attachments, read_frames
from pipeline.simulation.recordings import record
from pipeline.simulation.tasks import scene_seed
from pipeline.twin.legged import draw_legged_twin, play_on_twin, twin_robots
from schemas.contract import Contract
from schemas.recipe import DeployConfig, Recipe
from schemas.scene import SceneSpec
from stages.deploy_legged import deploy_legged, deploy_legged_scenes
from stages.harvest_legged import harvest_legged

RECIPE = Recipe(name="tests", robot="biped", scene="ground", task="stand", threads=1, deploy=DeployConfig(episodes=8))
ARRAYS = ("state", "environment", "action", "joint_action", "joint_velocity", "joint_effort", "link_poses", "sim_state",
          "controller", "joint_position", "imu")


def fallen_attempts(work):
    return [(e, t) for e, t in work.attempts if e.outcome.label == "failure"]


def test_without_quirks_the_robots_are_those_that_training_meets_to_the_bit():
    scenes = legged_scenes("stand", "biped", "gate", [(scene_seed("gate", 0, i), "thrown") for i in range(4)])
    body, task, ids = load_legged("biped"), load_legged_task("stand"), np.arange(4)
    robots, world, rng = LeggedRobots(body, task, scenes), LeggedWorld(body, task, 4), np.random.default_rng(0)
    world.restart(ids, starts_of(scenes, body))
    for _ in range(30):
        action = rng.uniform(-0.5, 0.5, (4, 10))
        assert np.array_equal(robots.observe(ids).state, world.observe())
        robots.act(action, ids)
        world.act(action)


def test_the_same_work_gives_the_same_bytes(alone, work):
    assert [f.read_bytes() for f in work().files] == [f.read_bytes() for f in alone.files]


def test_falls_are_noticed_from_the_senses_and_named_by_direction_and_phase(alone):
    failed = fallen_attempts(alone)
    assert failed, "the champion made by hand falls"
    for episode, trace in failed:
        outcome = episode.outcome
        assert outcome.judged_by == "sensors" and outcome.tick == len(trace) - 1
        lean = np.arccos(np.clip(trace.state[-1, 5], -1, 1))
        assert (outcome.trigger == "fell") == (lean > load_legged_task("stand").fallen_rad)
        assert outcome.family.startswith(outcome.trigger) and trace.phase[-1] in outcome.family
        assert any(e.name == "trigger" and outcome.family in e.text for e in trace.events)


@pytest.mark.parametrize(("turn", "says"), [((0, 1.2), "forward"), ((0, -1.2), "backward"), ((1.2, 0), "sideways"),
                                            ((-1.2, 0), "sideways")], ids=["forward", "back", "right", "left"])
def test_the_family_of_a_fall_says_where_to(turn, says):
    body, task = load_legged("biped"), load_legged_task("stand")
    world, senses, ids = LeggedWorld(body, task, 1), FallSenses(body, task, 1), np.arange(1)
    roll, pitch = turn
    state = world.observe().astype(float)
    quaternion = np.array([[np.cos((abs(roll) + abs(pitch)) / 2), np.sin(roll / 2), np.sin(pitch / 2), 0]])
    state[:, 3:6] = up_of(quaternion)
    senses.update(Observation(state, np.zeros((1, 0))), ids)
    assert fallen(senses, ids).tolist() == [0]
    assert fall_family("fell", senses, 0) == f"fell-{says}-rise"
    senses.tick[:] = 100
    assert fall_family("fell", senses, 0) == f"fell-{says}-hold"


def test_the_exact_state_before_a_fall_is_restored_and_the_recorded_actions_give_the_recording_again(alone):
    episode, trace = max(fallen_attempts(alone), key=lambda attempt: len(attempt[1]))
    robots = twin_robots(draw_legged_twin(episode.scene.twin), [episode.scene], threads=1)  # without its company
    begins, ids = max(0, len(trace) - 30), np.arange(1)
    robots.load(ids, trace.sim_state[[begins]], trace.controller[[begins]])
    for tick in range(begins, len(trace)):
        sim, controller = robots.save(ids)
        assert np.array_equal(sim[0], trace.sim_state[tick])
        assert np.array_equal(controller[0], trace.controller[tick])
        assert np.array_equal(robots.observe(ids).state[0], trace.state[tick])
        robots.act(trace.action[[tick]], ids)
        assert np.array_equal(robots.sent(ids)[0], trace.joint_action[tick])


def test_a_recording_holds_all_as_it_was_and_what_viewers_need(alone, tmp_path):
    episode, trace = alone.attempts[0]
    robots = twin_robots(draw_legged_twin(3), [episode.scene], threads=1)
    again = record(tmp_path, robots.setup, [episode], [trace], config={}, software={})[0]
    _, read = read_episode(again.path)
    assert all(np.array_equal(getattr(read, name), getattr(trace, name)) for name in ARRAYS)
    assert read.joints == load_legged("biped").joints and read.phase == trace.phase and read.events == trace.events
    body = load_legged("biped")
    measured = sensed(trace.state, body)
    assert np.allclose(trace.joint_position, measured.joints) and np.allclose(up_of(trace.imu[:, :4]), measured.up)
    files = read_attachments(alone.files[0])
    assert b"left_foot" in files["robot.urdf"] and b"payload" in files["scene.xml"]
    assert "left_foot" in trace.links and np.ptp(trace.link_poses[:, trace.links.index("torso"), 2]) > 0.05


def test_the_checks_accuse_no_recording_of_a_legged_robot(alone):
    for path in alone.files[:3]:
        assert check(read_recording(path), Contract()).findings == ()


def test_a_viewer_shows_the_robot_moving_on_its_ground(alone):
    episode, trace = fallen_attempts(alone)[0]
    path = next(f for f in alone.files if f.stem == episode.id)
    shown, _ = of_recording(path)
    moving = {body.name: body for body in shown.bodies}
    assert {"ground", "torso", "left_foot"} <= moving.keys() and np.ptp(moving["torso"].poses[:, 2]) > 0.05
    knee = trace.joint_position[:, trace.joints.index("left_knee")]
    assert np.array_equal(shown.lines["joints/left_knee/state"], knee)
    assert shown.lines["balance/lean"][-1] == pytest.approx(np.arccos(trace.state[-1, 5]), abs=1e-5)
    assert episode.outcome.family in shown.title and len(shown.path) == len(trace)


def test_a_fall_becomes_a_hard_case_whose_start_is_what_was_sensed_and_near_the_truth(alone):
    cases = harvest_legged(alone.attempts, before_s=0.6, generation=0)
    failed = fallen_attempts(alone)
    assert [c.episode for c in cases] == [e.id for e, _ in failed]
    for case, (episode, trace) in zip(cases, failed, strict=True):
        assert (case.family, case.tick) == (episode.outcome.family, len(trace) - 1)
        assert case.begins == max(0, case.tick - 30)
        true = trace.sim_state[case.begins]  # time, then x, y, z, quaternion, joints
        assert abs(case.start.height_m - true[3]) < 0.12
        lean = up_of(np.array([case.start.quaternion])) @ up_of(true[None, 4:8]).T
        assert np.arccos(np.clip(lean, -1, 1)) < 0.12
        blind = replace(trace, sim_state=0 * trace.sim_state, controller=0 * trace.controller,
                        link_poses=0 * trace.link_poses)
        assert harvest_legged([(episode, blind)], before_s=0.6, generation=0)[0].start == case.start


def test_a_hard_start_begins_an_attempt_where_the_robot_stood(alone):
    case = harvest_legged(alone.attempts, before_s=0.6, generation=0)[0]
    scene = hard_scene("stand", "biped", "gate", 5, case.start)
    assert scene.stratum == "hard" and scene.legged.blows and SceneSpec.model_validate_json(scene.model_dump_json())
    robots = LeggedRobots(load_legged("biped"), load_legged_task("stand"), [scene])
    now = sensed(robots.observe(np.arange(1)).state, load_legged("biped"))
    assert np.allclose(now.rates[0], case.start.rates, atol=1e-4)
    assert np.allclose(up_of(np.array([case.start.quaternion])), now.up, atol=1e-5)


def test_a_twin_is_the_same_every_time_and_no_two_are_alike(files):
    scenes = deploy_legged_scenes(RECIPE, seed=0, twin=5, generation=0)[:3]
    policy = LeggedPolicy(files["still"])
    one, again, other = (play_on_twin(policy, scenes, draw_legged_twin(k), threads=1) for k in (5, 5, 6))
    assert np.array_equal(one.ticks, again.ticks) and not np.array_equal(one.ticks, other.ticks)


def refused(kind, what, mend, call):
    with pytest.raises(kind, match=what) as caught:
        call()
    assert mend in caught.value.mend and "\n" not in caught.value.what


def test_a_policy_of_another_robot_is_refused_before_anything_moves(files, tmp_path):
    refused(PolicyError, "policy of strider", "hardcase rl train --body biped", lambda: deploy_legged(
        LeggedPolicy(files["wider"]), "c" * 16, RECIPE, seed=0, twin=0, generation=0, folder=tmp_path, software={}))
    assert not list(tmp_path.iterdir())


def test_recordings_of_other_robots_are_refused_by_the_harvest(alone):
    episode, trace = fallen_attempts(alone)[0]
    foreign = replace(trace, joints=("hip",))
    refused(ConfigError, "recording of 1 joints, biped has 10", "robot that it was made with",
            lambda: harvest_legged([(episode, foreign)], before_s=0.6, generation=0))
    arm = episode.model_copy(update={"scene": episode.scene.model_copy(
        update={"robot": "arm", "legged": None, "object_half_m": 0.02})})
    refused(ConfigError, "robot 'arm' among those of legged", "stages.harvest",
            lambda: harvest_legged([(arm, trace)], before_s=0.6, generation=0))


def test_a_state_of_another_size_is_not_restored(alone):
    episode, trace = alone.attempts[0]
    robots = twin_robots(draw_legged_twin(3), [episode.scene], threads=1)
    refused(SimulationError, "this robot has", "the recording names",
            lambda: robots.load(np.arange(1), trace.sim_state[:1, :-3], trace.controller[:1]))


def test_a_legged_recording_has_no_frames_of_a_dataset(alone):
    refused(RecordingError, "has no frames of a dataset", "hardcase loop --recipe biped",
            lambda: read_frames(alone.files[0]))


def test_a_scene_of_another_robot_gives_no_start(alone):
    scene = alone.attempts[0][0].scene
    short = scene.model_copy(update={"legged": scene.legged.model_copy(update={"bend": (0.0,)})})
    refused(SimulationError, "start of 1 joints, the robot has 10", "biped",
            lambda: starts_of([short], load_legged("biped")))
