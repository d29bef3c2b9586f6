"""What one tick of a session costs, beside LeRobot's own recording loop with the same robot and leader.

The virtual robot has six joints and no camera, the virtual leader gives six targets. Ours, at 50 Hz in real time
because chunks are closed by the clock: observe, read, guard, send, raw input, status line, and an MCAP file that is
read again whole. LeRobot's, without its sleeping: the calls of lerobot 0.6.1's record_loop, and a LeRobotDataset
whose episode is saved. CPU time of the process, all threads, a tick.
Run: OMP_NUM_THREADS=1 pytest tests/bench_teleop.py -s
"""

import json
import time
from pathlib import Path

import numpy as np
import pytest

from flows.teleop.devices import TeleopOrder, open_device, open_robot
from flows.teleop.display import StatusLine
from pipeline.robots.session import Controls, Session
from stages.teleop import teleop

HZ, TICKS, ROUNDS = 50.0, 250, 3
SIX = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
PLUGINS = Path(__file__).parent / "robots" / "plugins"


@pytest.fixture
def order(monkeypatch, tmp_path) -> TeleopOrder:
    """The virtual robot, and a leader whose hand goes round."""
    monkeypatch.syspath_prepend(str(PLUGINS))
    rows = [dict(zip(SIX, (10 + 5 * np.sin(np.arange(6) + k / 50)).tolist(), strict=True)) for k in range(TICKS)]
    (tmp_path / "hand.json").write_text(json.dumps(rows))
    keys = {"calibration_dir": str(tmp_path / "calibration")}
    return TeleopOrder(robot="lerobot:virtual_six", robot_keys={**keys, "port": "x"}, teleop="lerobot:virtual_leader",
                       teleop_keys={**keys, "hand": str(tmp_path / "hand.json")}, hz=HZ, max_step={"": 3.0})


def ours(order: TeleopOrder, folder: Path) -> float:
    """CPU seconds a tick of a session."""
    driven, device = open_robot(order, 0), open_device(order)
    driven.robot.connect()
    device.connect()
    line = StatusLine(driven.robot.signals, 1, HZ)
    session = Session("p7", "none", folder, {}, {}, 0, max_s=TICKS / HZ, ask=False, show=line.show)
    controls = Controls(device, driven.driver, driven.limits)
    began = time.process_time()
    (closed,) = teleop(driven.robot, controls, driven.scene_of, session)
    assert closed.episode.frames == TICKS and not closed.dropped
    return (time.process_time() - began) / TICKS


def lerobots(order: TeleopOrder, folder: Path) -> float:
    """CPU seconds a tick of the calls of lerobot's record_loop."""
    from lerobot.datasets import LeRobotDataset
    from lerobot.processor import make_default_processors
    from lerobot.utils.constants import ACTION, OBS_STR
    from lerobot.utils.feature_utils import build_dataset_frame, hw_to_dataset_features

    from pipeline.robots.plugins import make_robot, make_teleoperator

    robot, leader = make_robot("virtual_six", order.robot_keys), make_teleoperator("virtual_leader", order.teleop_keys)
    robot.connect()
    leader.connect()
    features = {**hw_to_dataset_features(robot.action_features, ACTION),
                **hw_to_dataset_features(robot.observation_features, OBS_STR)}
    dataset = LeRobotDataset.create("bench/teleop", fps=50, features=features, root=folder, use_videos=False)
    to_teleop, to_robot, from_robot = make_default_processors()
    began = time.process_time()
    for _ in range(TICKS):
        seen = robot.get_observation()
        frame = build_dataset_frame(dataset.features, from_robot(seen), prefix=OBS_STR)
        asked = to_teleop((leader.get_action(), seen))
        robot.send_action(to_robot((asked, seen)))
        dataset.add_frame({**frame, **build_dataset_frame(dataset.features, asked, prefix=ACTION), "task": "bench"})
    dataset.save_episode()
    return (time.process_time() - began) / TICKS


def test_a_tick_beside_lerobots_recording_loop(order, tmp_path):
    mine = [ours(order, tmp_path / f"ours-{k}") for k in range(ROUNDS)]
    theirs = [lerobots(order, tmp_path / f"theirs-{k}") for k in range(ROUNDS)]
    ratios = sorted(t / m for m, t in zip(mine, theirs, strict=True))
    print(f"\na tick: ours {1e3 * np.median(mine):.2f} ms, lerobot {1e3 * np.median(theirs):.2f} ms of CPU; "
          f"lerobot's takes {np.median(ratios):.1f} times ours [{ratios[0]:.1f} {ratios[-1]:.1f}]; "
          f"at 50 Hz ours takes {100 * HZ * np.median(mine):.1f} % of a core")
    assert np.median(mine) < 2e-3, "a session at 50 Hz must leave nine tenths of a core to the robot's driver"
