"""Who was right, told from what a robot sensed alone: its physics, its eyes, its state, and the verdict."""

from dataclasses import fields, replace

import numpy as np
import pytest

from pipeline.counterfactual.estimate import (
    JOINTS_RAD,
    OBJECT_M,
    Estimated,
    estimated,
    identified,
    judge_estimated,
)
from pipeline.counterfactual.estimate_eyes import identify_eyes
from pipeline.counterfactual.estimate_log import SensedLog
from pipeline.counterfactual.judging import Case, Named
from pipeline.counterfactual.ride import ride
from pipeline.counterfactual.windows import Window
from pipeline.errors import RecordingError
from pipeline.recording import read_episode
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_header import beginning
from pipeline.robots.simulated import SimulatedRobot
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.trace import Trace
from schemas.counterfactual import JudgeConfig
from schemas.episode import Outcome
from schemas.recipe import HarvestConfig

CHAMPION, CANDIDATE = "c" * 16, "d" * 16
SENSED = {"hz", "state", "environment", "action", "joint_action", "joint_velocity", "phase", "events"}


def blind(trace: Trace) -> Trace:
    """The recording with everything that a real robot cannot know replaced by NaN."""
    gone = {f.name: np.full_like(getattr(trace, f.name), np.nan) for f in fields(trace)
            if f.name not in SENSED and isinstance(getattr(trace, f.name), np.ndarray)}
    assert {"sim_state", "controller", "link_poses"} <= set(gone)
    return replace(trace, **gone)


def sensed(attempts):
    """Nothing of the start is known but robot and task: where the object really lies is made wrong on purpose."""
    return [(e.model_copy(update={"scene": e.scene.model_copy(update={
        "object_xy_m": (9.0, 9.0), "object_half_m": 9.0, "target_xy_m": (9.0, 9.0), "seed": 1, "stratum": "wrong"})}),
        SensedLog.of(blind(t), e.id)) for e, t in attempts]


@pytest.fixture(scope="module")
def robot(attempts, lab):
    return identified(sensed(attempts), lab, 0)


@pytest.fixture(scope="module")
def told(attempts, lab, robot, aiming):
    """Verdicts from sensors alone on a candidate that aims beside the cube, by how far."""

    def run(of=attempts, lab=lab, robot=robot, aside=0.05, **config):
        return judge_estimated(sensed(of), Named(CHAMPION, aiming()), Named(CANDIDATE, aiming(aside)), robot, lab,
                               JudgeConfig(**{"threshold": 0.02, "draws": 4} | config), HarvestConfig())

    return run


def test_the_arm_is_identified_from_its_joints(robot, draws):
    true = {d.name: d.value for d in draws}
    kp, damping, _, backlash, _ = robot.arm.values
    assert robot.arm.delay == true["delay"] and robot.arm.jitter == pytest.approx(true["jitter"], abs=0.12)
    assert kp == pytest.approx(true["kp"], rel=0.05) and damping == pytest.approx(1.0, rel=0.08)
    assert backlash == pytest.approx(true["backlash"], abs=0.0015) and robot.arm.miss_rad < 2e-4


def test_the_eyes_are_identified_from_what_the_fingers_held(attempts, robot):
    assert robot.eyes.holds == len(attempts) and robot.eyes.noise == pytest.approx(0.0015, rel=0.25)
    assert np.abs(robot.eyes.bias).max() < 0.0015
    off = [replace(log, environment=log.environment + np.array([0.0, 0.006, *[0.0] * 5]))
           for _, log in sensed(attempts)]
    shifted = identify_eyes(off, [0.02] * len(off), robot.middle_m)
    assert identify_eyes([], [], 0.0).cov[0, 0] > 25 * shifted.cov[0, 0], "nothing held, little known"
    assert shifted.bias - robot.eyes.bias == pytest.approx([0.0, 0.006], abs=0.0015)


def test_the_verdict_from_sensors_alone_is_that_of_the_exact_state(told, close_call):
    estimate = told()
    assert [j.episode for j in estimate.judgements] == [j.episode for j in close_call.judgements]
    assert [j.verdict for j in estimate.judgements] == [j.verdict for j in close_call.judgements]
    assert {j.verdict for j in estimate.judgements} == {"champion"}
    assert all(j.estimated and not e.estimated for j, e in
               zip(estimate.judgements, close_call.judgements, strict=True))
    assert not {j.id for j in estimate.judgements} & {j.id for j in close_call.judgements}


def test_the_same_log_gives_the_same_verdicts(told):
    assert told().judgements == told().judgements


def test_a_candidate_that_parts_while_the_cube_is_held_is_judged_and_the_replay_error_told(
        lab, robot, aiming, attempts):
    class Lifting(type(aiming())):
        """Goes on lifting what it has lifted by 9 cm."""

        def act(self, observation, ids):
            action = super().act(observation, ids)
            action[observation.environment[:, 2] > 0.09, 2] = 0.02
            return action

    found = judge_estimated(sensed(attempts), Named(CHAMPION, aiming()), Named(CANDIDATE, Lifting()), robot, lab,
                            JudgeConfig(threshold=0.02, draws=4), HarvestConfig())
    assert found.judgements and all(j.tick > 10 and j.verdict == "champion" for j in found.judgements)
    assert all(0 < j.replay_error_rad < JOINTS_RAD and 0.0015 < j.replay_error_m < OBJECT_M for j in found.judgements)


@pytest.mark.parametrize(("column", "says"), [("state", "misses the joints by"),
                                              ("environment", "misses the object by")])
def test_a_moment_that_the_stand_in_cannot_reproduce_is_refused(attempts, lab, robot, aiming, column, says):
    episode, log = sensed(attempts)[0]
    changed = getattr(log, column).copy()
    changed[:, 0] += np.where(np.arange(len(log)) > 14, 0.25 if column == "state" else 0.08, 0.0)
    seen = ride(aiming(), [log])[0]
    case = Case(episode, replace(log, **{column: changed}), Window(20, 24, 0.1), seen, seen)
    assert says in str(estimated([case], robot, lab, JudgeConfig())[0])
    assert isinstance(estimated([replace(case, log=log)], robot, lab, JudgeConfig())[0], Estimated)


def test_a_robot_that_was_driven_live_is_judged_from_its_recording(tmp_path, lab, draws, aiming, told):
    scene = sample_scene("pick-place", "teleop", scene_seed("teleop", 7, 1), "common")
    robot = SimulatedRobot(lab.world([scene], [draws]), "arm", judged=False, speed=0)
    driver, one = aiming(), np.arange(1)
    driver.reset(1)
    episode = beginning(id="e" * 16, origin="teleop", scene=scene.model_copy(update={"scene": "real"}),
                        control_hz=20.0, generation=0, actor=CHAMPION)
    with LiveRecorder(tmp_path / "live.mcap", episode, attachments=robot.attachments()) as recorder:
        for tick in range(60):
            recorder.phase(robot.phase(), tick=tick)
            robot.act(driver.act(robot.observe(one), one), one)
            recorder.tick(tick, robot.row())
        closed = recorder.close(Outcome(label="success", judged_by="sensors"))
    found = told(of=[read_episode(closed.path)])
    assert [j.verdict for j in found.judgements] == ["champion"] and found.judgements[0].estimated


def test_a_recording_without_what_is_needed_says_so(attempts):
    trace = attempts[0][1]
    with pytest.raises(RecordingError, match=r"joint velocity is not 7 finite values a tick(.|\n)*mend: estimate from"):
        SensedLog.of(replace(trace, joint_velocity=trace.joint_velocity * np.nan), "a recording")
