"""LeRobot's robots and teleoperators, found and made by LeRobot's own plugin mechanism; the devices are virtual."""

import json
from typing import ClassVar

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from flows.teleop.devices import TeleopOrder, open_device, open_robot
from flows.teleop.teleoperation import run_teleop
from pipeline.errors import ConfigError, RobotError
from pipeline.frames import JOINTS
from pipeline.recording import read_episode
from pipeline.robots.lerobot_teleop import feature_names
from pipeline.robots.plugins import known
from pipeline.simulation.bodies import load_body
from pipeline.simulation.expert import Expert
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.world import World

SIX = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture
def hand(tmp_path):
    """A file that a virtual device is moved by."""

    def write(rows) -> str:
        path = tmp_path / f"hand-{len(list(tmp_path.glob('hand-*')))}.json"
        path.write_text(json.dumps(rows))
        return str(path)

    return write


@pytest.fixture
def order(plugins, tmp_path):
    """An order for a virtual robot and a virtual device."""

    def make(robot: str, teleop: str, hand: str, **options) -> TeleopOrder:
        keys = {"calibration_dir": str(tmp_path / "calibration")}
        return TeleopOrder(robot=f"lerobot:{robot}", robot_keys=keys | options.pop("robot_keys", {}),
                           teleop=f"lerobot:{teleop}", teleop_keys=keys | {"hand": hand},
                           **({"hz": 200.0, "max_s": 5.0} | options))

    return make


def demonstrated(session: int) -> list[dict[str, float]]:
    """Joint targets of the expert at the first start of a session: what a person's hand does to a leader arm."""
    scene = sample_scene("pick-place", "teleop", scene_seed("teleop", session, 0), "common")
    world, expert = World(compose(load_body("arm"), "table"), [scene], from_draws([()]), threads=1), Expert()
    expert.reset(1)
    tracer = Tracer(world)
    assert rollout(world, expert, tracer=tracer).success.all()
    rows = tracer.traces()[0].joint_action
    return [dict(zip((*JOINTS, "gripper"), map(float, row), strict=True)) for row in rows]


def said(path, topic):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [message for _, _, _, message in reader.iter_decoded_messages(topics=[topic])]


def test_lerobots_own_devices_and_those_of_plugins_are_known_by_name(plugins):
    robots, devices = known("robot"), known("teleop")
    assert {"so101_follower", "koch_follower", "virtual_arm", "virtual_six"} <= set(robots)
    assert {"so101_leader", "gamepad", "virtual_leader", "virtual_pad"} <= set(devices)


def test_a_leader_arm_picks_and_places_with_a_lerobot_robot_built_like_the_arm(order, hand, store):
    asked = order("virtual_arm", "virtual_leader", hand(demonstrated(7)), operator="p7", consent="form-7")
    assert not run_teleop(asked, store.root)
    (episode,) = store.episodes()
    assert (episode.outcome.label, episode.outcome.judged_by) == ("success", "sensors")
    assert (episode.scene.robot, episode.scene.scene, episode.control_hz) == ("arm", "real", 200.0)
    read, trace = read_episode(store.blob(episode.blob))
    assert read == episode and trace.sim_state.size == 0
    assert np.hypot(*(trace.environment[0, :2] - np.array(episode.scene.object_xy_m))) == 0
    on_mark = np.hypot(*(trace.environment[-1, :2] - trace.environment[-1, 4:6]))
    assert on_mark < 0.025 and np.ptp(trace.environment[:, 2]) > 0.05, "the cube was lifted and put on the mark"
    assert np.abs(np.diff(trace.joint_action[:, :6], axis=0)).max() <= 0.15 + 1e-9


def test_a_leader_arm_drives_the_simulated_robot(order, hand, simulated, store):
    asked = order("virtual_arm", "virtual_leader", hand(demonstrated(0)))
    onto_arm = TeleopOrder(robot="arm", teleop=asked.teleop, teleop_keys=asked.teleop_keys, speed=0.0, max_s=9.0)
    assert not run_teleop(onto_arm, store.root)
    (episode,) = store.episodes()
    assert (episode.outcome.label, episode.outcome.judged_by) == ("success", "simulator")
    joys = said(store.blob(episode.blob), "/teleop/joy")
    assert joys[0].axes == pytest.approx(list(demonstrated(0)[0].values())), "the leader's own joints are recorded"


def test_an_arm_that_perceives_no_object_is_recorded_by_its_joints_and_takes_no_policy(order, hand, store):
    blind = order("virtual_arm", "virtual_pad", hand([{"delta_z": 1.0}] * 10 + [{"success": 1}]),
                  robot_keys={"sees": "false"})
    assert not run_teleop(blind, store.root)
    (episode,) = store.episodes()
    assert (episode.scene.robot, episode.scene.stratum) == ("virtual_arm", "unknown")
    assert (episode.outcome.label, episode.outcome.judged_by) == ("success", "operator")
    states = said(store.blob(episode.blob), "/joint_states")
    assert states[0].name == [*JOINTS, "gripper"] and states[0].position != states[-1].position
    with pytest.raises(ConfigError, match="does not perceive what a policy looks at"):
        run_teleop(TeleopOrder(**{f: getattr(blind, f) for f in ("robot", "robot_keys", "teleop", "teleop_keys")},
                               policy="expert"), store.root)


def test_any_other_robot_is_jogged_joint_by_joint_within_its_step(order, hand, store):
    rows = [{"delta_x": 1.0, "gripper": 2.0}] * 8 + [{"delta_y": -1.0}] * 8 + [{"success": 1}]
    six = order("virtual_six", "virtual_pad", hand(rows), max_step={"": 2.0, "gripper.pos": 5.0},
                robot_keys={"port": "/dev/null", "picture": "true"})
    assert not run_teleop(six, store.root)
    (episode,) = store.episodes()
    assert (episode.scene.robot, episode.frames) == ("virtual_six", 17)
    path = store.blob(episode.blob)
    sent = np.array([m.position for m in said(path, "/joint_commands")])
    assert said(path, "/joint_commands")[0].name == [f"{name}.pos" for name in SIX]
    assert sent[-1] == pytest.approx([26, -6, 10, 10, 10, 50]), "8 ticks of 2, of 5 for the gripper, from 10"
    assert np.abs(np.diff(sent, axis=0)).max() <= 5.0
    measured = np.array([m.position for m in said(path, "/joint_states")])
    assert measured[0] == pytest.approx([10] * 6) and measured[-1, 0] == pytest.approx(26, abs=0.1)
    assert len(said(path, "/camera/wrist/image/compressed")) == 17


def test_a_rover_stands_still_when_nobody_pushes(order, hand, store):
    rows = [{"delta_x": 1.0}] * 4 + [{}] * 2 + [{"delta_x": 0.5, "delta_y": -1.0}] * 2 + [{}] + [{"success": 1}]
    largest = {"linear_velocity": 0.4, "angular_velocity": 2.0}
    rover = order("virtual_rover", "virtual_pad", hand(rows), max_step=largest)
    assert not run_teleop(rover, store.root)
    (episode,) = store.episodes()
    sent = [tuple(m.position) for m in said(store.blob(episode.blob), "/joint_commands")]
    assert sent == [(0.4, 0.0)] * 4 + [(0.0, 0.0)] * 2 + [(0.2, -2.0)] * 2 + [(0.0, 0.0)] * 2
    heard = said(store.blob(episode.blob), "/joint_states")
    assert heard[0].name == ["battery_percent"] and heard[-1].position[0] == 100 - 9


def test_a_leader_far_from_its_robot_is_followed_at_the_largest_step(order, hand, store):
    far = [dict.fromkeys(SIX, 90.0)]
    six = order("virtual_six", "virtual_leader", hand(far), max_step={"": 3.0}, max_s=1.0,
                robot_keys={"port": "/dev/null"})
    run_teleop(six, store.root)
    (episode,) = store.episodes()
    path = store.blob(episode.blob)
    sent = np.array([m.position for m in said(path, "/joint_commands")])[:, 0]
    assert sent[:4] == pytest.approx([13, 16, 19, 22]) and sent[-1] == 90
    events = said(path, "/events")
    assert events[0].msg == "limited " + ", ".join(f"{name}.pos" for name in SIX)
    asked = said(path, "/joint_commands/asked")
    cut = sent[:-1] != 90  # what was asked for is recorded where it is not what was sent
    assert 0 < len(asked) <= cut.sum() + 1 < len(sent)
    assert asked[0].name == [f"{name}.pos" for name in SIX] and list(asked[0].position) == [90] * len(SIX)


def test_a_nan_of_a_device_never_reaches_the_motors_and_ends_the_attempt(order, hand, store):
    rows = [{"delta_x": 1.0}] * 3 + [{"delta_x": None}] * 3
    six = order("virtual_six", "virtual_pad", hand(rows), max_step={"": 2.0}, robot_keys={"port": "/dev/null"})
    with pytest.raises(RobotError, match=r"shoulder_pan.pos\) is NaN for 3 ticks; the robot was stopped"):
        run_teleop(six, store.root)
    (episode,) = store.episodes()
    assert episode.outcome.label == "unknown" and "is NaN" in str(episode.outcome.reason)
    path = store.blob(episode.blob)
    assert [m.position[0] for m in said(path, "/joint_commands")] == pytest.approx([12, 14, 16, 16, 16])
    assert [e.msg for e in said(path, "/events")] == ["action[0] (shoulder_pan.pos) is NaN; held still"]


@pytest.mark.parametrize(("robot", "keys", "what"), [
    ("virtual_six", {"port": "x", "broken_encoder_at": "4"}, "elbow_flex.pos of lerobot:virtual_six is measured as na"),
    ("virtual_arm", {"cable_off_at": "5"}, "refuses an action: Failed to write 'Goal_Position': no status packet"),
], ids=["a broken encoder", "a cable that comes off"])
def test_a_robot_that_fails_ends_its_attempt_which_is_kept(order, hand, store, robot, keys, what):
    asked = order(robot, "virtual_pad", hand([{"delta_x": 0.5}]), robot_keys=keys, max_step={"": 1.0})
    with pytest.raises(RobotError) as failed:
        run_teleop(asked, store.root)
    assert what in failed.value.what
    (episode,) = store.episodes()
    assert (episode.frames, episode.outcome.label) == (4, "unknown") and what in str(episode.outcome.reason)


def test_events_of_a_lerobot_device_take_over_and_give_back(order, hand, store, simulated):
    rows = [{}] * 6 + [{"delta_z": 1.0, "is_intervention": 1}] * 5 + [{}] * 400
    pad = order("virtual_arm", "virtual_pad", hand(rows))
    asked = TeleopOrder(robot="arm", teleop=pad.teleop, teleop_keys=pad.teleop_keys, policy="expert", speed=0.0,
                        operator="p7")
    assert not run_teleop(asked, store.root)
    (episode,) = store.episodes()
    assert [(s.kind, s.actor, s.stop - s.start) for s in episode.segments][:2] == [
        ("autonomous", "expert", 6), ("intervention", "p7", 5)]
    assert episode.segments[2].kind == "autonomous" and episode.outcome.label == "success"


@pytest.mark.parametrize(("options", "what", "mend"), [
    ({"robot": "lerobot:so900"}, "lerobot knows no robot 'so900'", "so101_follower"),
    ({"robot": "lerobot:so101_follower"}, "'so101_follower' needs port", "--robot-key port=VALUE"),
    ({"robot": "lerobot:virtual_six", "robot_keys": {"port": "x", "speed": "3"}}, "'virtual_six' has no key speed",
     "picture"),
    ({"robot": "lerobot:virtual_six", "robot_keys": {"port": "x"}}, "nobody said how far shoulder_pan.pos",
     "--max-step 2 where the robot counts in degrees"),
    ({"robot": "lerobot:virtual_six", "robot_keys": {"port": "x"}, "max_step": {"hip.pos": 1.0}},
     "lerobot:virtual_six has no action hip.pos", "wrist_roll.pos"),
    ({"robot": "lerobot:virtual_six", "robot_keys": {"port": "x", "picture": "7 cm"}}, "refuses its config", "YAML"),
    ({"plugins": ("no_such_module",), "robot": "lerobot:virtual_six"}, "plugin 'no_such_module' does not load",
     "PYTHONPATH"),
], ids=["name", "missing key", "unknown key", "no step", "step of nothing", "bad value", "plugin"])
def test_a_robot_that_cannot_be_opened_says_why(plugins, tmp_path, options, what, mend):
    keys = options.get("robot_keys", {}) | {"calibration_dir": str(tmp_path)}
    with pytest.raises(ConfigError) as refused:
        open_robot(TeleopOrder(**(options | {"robot_keys": keys})), 0)
    assert what in refused.value.what and mend in refused.value.mend


@pytest.mark.parametrize(("teleop", "keys", "what"), [
    ("so900_leader", {}, "lerobot knows no teleoperator 'so900_leader'"),
    ("keyboard", {}, "'pynput' is required"),
    ("phone", {}, "'hebi-py' is required"),
], ids=["name", "driver not installed", "driver not installed, lerobot wraps it"])
def test_a_device_that_cannot_be_opened_says_why(plugins, teleop, keys, what, tmp_path):
    with pytest.raises((ConfigError, RobotError)) as refused:
        open_device(TeleopOrder(teleop=f"lerobot:{teleop}", teleop_keys=keys | {"calibration_dir": str(tmp_path)}))
    assert what in refused.value.what, refused.value


def test_a_device_whose_action_is_not_numbers_is_refused():
    class Phone:
        action_features: ClassVar = {"phone.pos": np.ndarray, "phone.enabled": bool, "phone.raw_inputs": dict}

    with pytest.raises(RobotError, match=r"cannot be used: phone\.pos, phone\.raw_inputs are not numbers"):
        feature_names(Phone(), "action_features", "--teleop lerobot:phone")


def test_a_leader_of_other_joints_is_refused_before_anything_moves(order, hand, store):
    other = order("virtual_six", "virtual_leader", hand([{"joint1": 0.0, "gripper": 0.0}]), max_step={"": 1.0},
                  robot_keys={"port": "x"})
    with pytest.raises(RobotError) as refused:
        run_teleop(other, store.root)
    assert refused.value.what == (
        "teleoperator 'lerobot:virtual_leader' does not fit robot 'lerobot:virtual_six': missing: shoulder_pan, "
        "shoulder_lift, elbow_flex, wrist_flex, wrist_roll; not of the robot: joint1")
    assert store.episodes() == []


def test_cameras_of_the_scene_are_recorded_beside_the_robot(order, hand, store, capsys):
    pad = order("virtual_six", "virtual_pad", hand([{"delta_x": 1.0}] * 30 + [{"success": 1}]))
    asked = TeleopOrder(teleop=pad.teleop, teleop_keys=pad.teleop_keys, cameras=("front", "top"), size=(64, 48))
    assert not run_teleop(asked, store.root)
    (episode,) = store.episodes()
    path = store.blob(episode.blob)
    if "no pictures" in capsys.readouterr().err:
        assert episode.frames == 31, "where nothing renders, all that needs no picture goes on"
        pytest.skip("nothing can render here")
    for camera in ("front", "top"):
        pictures = said(path, f"/camera/{camera}/image/compressed")
        assert len(pictures) > 5 and bytes(pictures[0].data[:2]) == b"\xff\xd8"
        assert pictures[0].header.frame_id == camera
    assert read_episode(path)[0] == episode
