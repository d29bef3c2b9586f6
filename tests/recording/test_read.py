"""What is written comes back: laws over any values, not examples."""

import dataclasses
import hashlib
import logging
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.recording import read_attachments, read_episode, read_frames, write_episode
from pipeline.trace import Event

sizes = st.integers(1, 12)
finite = st.floats(allow_nan=False, allow_infinity=False, width=64, min_value=-3e38, max_value=3e38)
anything = st.floats(allow_nan=True, allow_infinity=True, width=64)


def rows(m: int, width: int, values: st.SearchStrategy[float]) -> st.SearchStrategy[np.ndarray]:
    return arrays(np.float64, (m, width), elements=values)


@settings(max_examples=40, deadline=None)
@given(data=st.data(), m=sizes, nstate=st.integers(0, 40), k=st.integers(0, 9))
def test_an_episode_comes_back_bit_for_bit(data, trace, episode, same_trace, m, nstate, k):
    written = dataclasses.replace(
        trace(m, nstate=nstate, k=k), state=data.draw(rows(m, 16, finite)), environment=data.draw(rows(m, 7, finite)),
        action=data.draw(rows(m, 5, finite)), joint_action=data.draw(rows(m, 7, finite)),
        sim_state=data.draw(rows(m, nstate, anything)), controller=data.draw(rows(m, k, anything)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        digest = write_episode(path, episode(m), written, attachments={}, fsync=False)
        found, back = read_episode(path)
        again, frames = read_frames(path)
    same_trace(back, written)
    assert found == again == episode(m).model_copy(update={"blob": digest})
    for ours, theirs in zip(frames.columns().values(), written.frames().columns().values(), strict=True):
        assert ours.dtype == np.float32 and ours.tobytes() == theirs.tobytes()


halves = st.integers(1, 2**23).map(lambda k: float(np.float32(k / 2**22)) + 2.0**-24)
"""Angles half way between two float32, where one wrong bit of the float64 falls to the other side."""


@settings(max_examples=60, deadline=None)
@given(yaw=st.lists(st.one_of(halves, st.floats(-7, 7)), min_size=1, max_size=20))
def test_the_perceived_yaw_is_the_same_float32(yaw, trace, episode):
    m = len(yaw)
    environment = np.zeros((m, 7))
    environment[:, 3] = yaw
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        write_episode(path, episode(m), dataclasses.replace(trace(m), environment=environment), attachments={},
                      fsync=False)
        _, frames = read_frames(path)
    assert frames.environment[:, 3].tobytes() == np.float32(yaw).tobytes()


@pytest.mark.parametrize("m", [1, 2, 700], ids=["one tick", "two ticks", "several chunks"])
def test_any_length_comes_back(tmp_path, m, trace, episode, same_trace):
    write_episode(tmp_path / "a.mcap", episode(m), trace(m), attachments={})
    same_trace(read_episode(tmp_path / "a.mcap")[1], trace(m))


def test_a_body_without_links_rewards_shadows_or_events_comes_back(tmp_path, trace, episode, same_trace):
    bare = dataclasses.replace(trace(), links=(), link_poses=np.zeros((60, 0, 7)), reward={}, shadows={}, events=())
    write_episode(tmp_path / "a.mcap", episode(), bare, attachments={})
    same_trace(read_episode(tmp_path / "a.mcap")[1], bare)


def test_events_of_one_tick_and_after_the_last_come_back_in_order(tmp_path, trace, episode, same_trace):
    events = tuple(Event(tick, 20, name, "") for tick, name in ((0, "a"), (30, "b"), (30, "c"), (60, "after the last")))
    busy = dataclasses.replace(trace(), events=events)
    write_episode(tmp_path / "a.mcap", episode(), busy, attachments={})
    same_trace(read_episode(tmp_path / "a.mcap")[1], busy)


def test_topics_at_another_rate_do_not_disturb(recording, rewrite, trace, same_trace):
    every_other = rewrite(recording.read_bytes(), lambda topic, m: None if topic.startswith("/observation/o")
                          and m.sequence % 2 else m)
    recording.write_bytes(every_other)
    same_trace(read_episode(recording)[1], trace())


def test_the_package_imports_neither_physics_nor_networks():
    heavy = "{'mujoco', 'torch', 'lerobot', 'prefect', 'pandas', 'rerun'}"
    code = f"import sys, pipeline.recording; sys.exit(bool({heavy} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": str(Path.cwd())})


def test_the_blob_is_the_hash_of_the_file(recording):
    assert read_frames(recording)[0].blob == hashlib.sha256(recording.read_bytes()).hexdigest()


def test_attachments_come_back(recording, attachments):
    assert read_attachments(recording) == attachments


def test_a_whole_file_is_read_without_a_warning(recording, caplog):
    with caplog.at_level(logging.WARNING):
        read_episode(recording)
    assert caplog.records == []


def test_a_file_of_the_mcap_library_in_our_dialect_is_read(recording, rewrite, tmp_path, trace, same_trace):
    other = tmp_path / "other.mcap"
    other.write_bytes(rewrite(recording.read_bytes(), lambda topic, message: message))
    same_trace(read_episode(other)[1], trace())
