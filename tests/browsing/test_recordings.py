"""Live recordings with cameras, robots with other joints, and ingested frames are shown too."""

import numpy as np
import pytest
import simplejpeg

from pipeline.browsing.attempts import of_table
from pipeline.browsing.recording import of_recording
from pipeline.frames import FeatureTable
from pipeline.recording import read_episode
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_rows import Row, joint_layout
from pipeline.recording.read import open_recording
from schemas.episode import Segment

PICTURE = np.full((32, 48, 3), (20, 160, 60), np.uint8)


def test_a_live_recording_shows_its_cameras_when_they_looked(shelf, store, tmp_path):
    source = store.blob(shelf.demonstrations[0].blob)
    episode, trace = read_episode(source)
    start = 1_800_000_000_000_000_000
    header = episode.model_copy(update={"frames": 1, "segments": (Segment(
        kind="demonstration", start=0, stop=1, actor="expert"),), "blob": None})
    with LiveRecorder(tmp_path / "live.mcap", header, attachments=open_recording(source).attachments) as recorder:
        for k in range(10):
            stamp = start + k * 50_000_000
            row = Row(trace.state[k], trace.environment[k], trace.action[k], trace.joint_action[k],
                      links=trace.links, link_poses=trace.link_poses[k])
            recorder.tick(k, row, stamp_ns=stamp)
            if k % 2:
                recorder.image("wrist", PICTURE, tick=k, stamp_ns=stamp + 7_000_000)
        recorder.close(episode.outcome)
    shown, _ = of_recording(tmp_path / "live.mcap")
    assert shown.seconds == pytest.approx(np.arange(10) / 20)
    assert shown.pictures["wrist"].seconds == pytest.approx(np.arange(1, 10, 2) / 20 + 0.007)
    assert simplejpeg.decode_jpeg(shown.pictures["wrist"].blobs[0]).shape == PICTURE.shape
    assert {body.name for body in shown.bodies} >= {"hand", "object", "table"}


def test_a_robot_with_other_joints_shows_state_and_command(shelf, store, tmp_path):
    names = ("shoulder_pan", "elbow_flex")
    header = read_episode(store.blob(shelf.demonstrations[0].blob))[0]
    header = header.model_copy(update={"frames": 1, "blob": None, "segments": (Segment(
        kind="demonstration", start=0, stop=1, actor="ada"),)})
    with LiveRecorder(tmp_path / "other.mcap", header, attachments={}, layout=joint_layout(names)) as recorder:
        for k in range(5):
            recorder.tick(k, np.array([k, 2 * k, k + 0.5, 2 * k + 0.5], np.float64))
        recorder.close(header.outcome)
    shown, _ = of_recording(tmp_path / "other.mcap")
    assert shown.lines["joints/elbow_flex/state"] == pytest.approx(2.0 * np.arange(5))
    assert shown.lines["joints/shoulder_pan/command"] == pytest.approx(np.arange(5) + 0.5)
    assert not shown.bodies


def test_ingested_values_of_one_name_share_a_plot(shelf):
    names = {"observation.state": ("j1", "j2"), "action": ("j1",), "observation.force": ("fz",)}
    values = {n: np.arange(3 * len(v), dtype=np.float32).reshape(3, -1) for n, v in names.items()}
    shown = of_table(shelf.demonstrations[0], FeatureTable(names, values))
    assert set(shown.lines) == {"joints/j1/state", "joints/j2/state", "joints/j1/command", "observation.force/fz"}
    assert shown.lines["joints/j2/state"].tolist() == [1.0, 3.0, 5.0]
