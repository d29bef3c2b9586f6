"""Episodes and traces of any length, and files that are changed with the mcap library's own tools."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from mcap.records import Message

from pipeline.recording import write_episode
from pipeline.recording.live_header import beginning
from pipeline.recording.live_rows import Row
from pipeline.trace import Event, Shadow, Trace
from schemas.episode import Episode, Outcome, Segment
from schemas.scene import Draw, SceneSpec

URDF = b'<robot name="arm"><link name="link0"/></robot>'
ATTACHMENTS = {"scene.xml": b"<mujoco/>", "robot.urdf": URDF, "config.json": b"{}", "randomization.json": b"[]"}


def make_trace(m: int = 60, *, seed: int = 0, nstate: int = 90, k: int = 30) -> Trace:
    rng = np.random.default_rng(seed)

    def walk(*shape: int) -> np.ndarray:
        return np.cumsum(rng.normal(scale=0.01, size=shape), axis=0)

    return Trace(
        hz=20.0, state=walk(m, 16), environment=walk(m, 7), action=walk(m, 5), joint_action=walk(m, 7),
        joint_velocity=walk(m, 7), joint_effort=walk(m, 7), links=("base", "link1", "wrist-cam", "object"),
        link_poses=walk(m, 4, 7), phase=tuple("reach" if t < m // 2 else "lift" for t in range(m)),
        reward={"reach": walk(m), "lift": walk(m)}, sim_state=walk(m, nstate), controller=walk(m, k),
        shadows={"0123456789abcdef": Shadow(walk(m, 7), walk(m))},
        events=(Event(m // 3, 20, "note", "it began"), Event(m - 1, 30, "stall", "kein Fortschritt für 30 Takte")))


def make_episode(m: int = 60) -> Episode:
    scene = SceneSpec(family="deploy", seed=7, robot="arm", scene="table", task="pick-place", stratum="rare",
                      object_xy_m=(0.3, 0.1), object_yaw_rad=0.2, object_half_m=0.02, target_xy_m=(0.3, -0.1),
                      draws=(Draw(name="friction", unit="1", value=0.1 + 0.2),), twin=3)
    half = max(1, m // 2)
    segments = [Segment(kind="autonomous", start=0, stop=half, actor="0123456789abcdef")]
    if half < m:
        segments.append(Segment(kind="intervention", start=half, stop=m, actor="operator-1"))
    return Episode(id="00112233445566aa", origin="deployed", scene=scene, control_hz=20.0, frames=m,
                   outcome=Outcome(label="failure", judged_by="sensors", trigger="stall", family="stall", tick=m - 1),
                   segments=tuple(segments), policy="0123456789abcdef", generation=1)


def assert_same_trace(found: Trace, expected: Trace) -> None:
    """Bit for bit, the order of rewards and shadows included."""
    for entry in dataclasses.fields(Trace):
        a, b = getattr(found, entry.name), getattr(expected, entry.name)
        if isinstance(b, np.ndarray):
            assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes(), entry.name
        elif entry.name == "reward":
            assert [(n, v.tobytes()) for n, v in a.items()] == [(n, v.tobytes()) for n, v in b.items()]
        elif entry.name == "shadows":
            assert list(a) == list(b)
            for i in b:
                assert a[i].joint_commands.tobytes() == b[i].joint_commands.tobytes()
                assert a[i].disagreement.tobytes() == b[i].disagreement.tobytes()
        else:
            assert a == b, entry.name


@pytest.fixture(scope="session")
def trace():
    return make_trace


@pytest.fixture(scope="session")
def episode():
    return make_episode


@pytest.fixture(scope="session")
def attachments():
    return dict(ATTACHMENTS)


@pytest.fixture(scope="session")
def start():
    """What a live recording knows when it begins."""
    def make(**other) -> Episode:
        known = {"id": "00112233445566aa", "origin": "scripted", "scene": make_episode().scene, "control_hz": 20.0,
                 "generation": 0, "actor": "expert"}
        return beginning(**known | other)

    return make


@pytest.fixture(scope="session")
def row():
    """One tick of a trace, as a robot hands it to the recorder."""
    def make(trace: Trace, tick: int) -> Row:
        return Row(trace.state[tick], trace.environment[tick], trace.action[tick], trace.joint_action[tick],
                   trace.joint_velocity[tick], trace.joint_effort[tick], trace.links, trace.link_poses[tick],
                   {term: float(values[tick]) for term, values in trace.reward.items()},
                   {name: (s.joint_commands[tick], float(s.disagreement[tick])) for name, s in trace.shadows.items()},
                   trace.sim_state[tick], trace.controller[tick])

    return make


@pytest.fixture(scope="session")
def bare_row():
    """One tick of a real robot: no simulator, no true poses, no measured velocity."""
    def make(trace: Trace, tick: int, **other) -> Row:
        own = Row(trace.state[tick], trace.environment[tick], trace.action[tick], trace.joint_action[tick],
                  joint_effort=trace.joint_effort[tick])
        return dataclasses.replace(own, **other)

    return make


@pytest.fixture(scope="session")
def same_trace():
    return assert_same_trace


@pytest.fixture
def recording(tmp_path):
    """A whole recording of 60 ticks."""
    path = tmp_path / "a.mcap"
    write_episode(path, make_episode(), make_trace(), attachments=ATTACHMENTS)
    return path


type Change = Callable[[str, Message], Message | None]


@pytest.fixture
def rewrite(rewritten):
    """Write a recording again with the mcap library, every message passed through `change`; None drops it."""

    def again(data: bytes, change: Change) -> bytes:
        return rewritten(data, lambda topic, m: filter(None, [change(topic, m)]), chunk_size=50_000)

    return again
