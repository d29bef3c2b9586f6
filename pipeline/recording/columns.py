"""What an episode says on every topic: fixed-length messages as columns, the few others one by one."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import RecordingError
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.recording import cdr
from pipeline.recording.dialect import JOINT_NAMES, stamp_ns
from pipeline.trace import Rows, Trace


@dataclass(frozen=True, slots=True)
class Column:
    """One topic with one message a tick, all of one length."""

    topic: str
    layout: cdr.Layout
    values: tuple[Rows, ...]
    """One array (m, count) for every run of float64 in the layout."""


@dataclass(frozen=True, slots=True)
class Single:
    """One message of any length; it goes before the columns of its tick."""

    topic: str
    tick: int
    payload: bytes


def columns(trace: Trace) -> Iterator[Column]:
    """Every topic that speaks once a tick, in the order of its channels."""
    names = trace.joints or JOINT_NAMES
    yield from _legged(trace) if trace.joints else _arm(trace)
    if trace.links:
        wxyz_last = trace.link_poses[:, :, [0, 1, 2, 4, 5, 6, 3]]
        yield Column("/tf", cdr.tf_message(trace.links), tuple(wxyz_last[:, k] for k in range(len(trace.links))))
    for term, values in trace.reward.items():
        yield Column(f"/reward/{term}", cdr.float64(), (values[:, None],))
    for policy, shadow in trace.shadows.items():
        yield _targets(f"/policy/{policy}/joint_commands", names, shadow.joint_commands, torque=trace.torque)
        yield Column(f"/policy/{policy}/disagreement", cdr.float64(), (shadow.disagreement[:, None],))
    for name, values in trace.signals.items():
        yield Column(f"/signal/{name}", cdr.float64(), (values[:, None],))
    yield _array("/sim/state", "mjSTATE_INTEGRATION", trace.sim_state)
    yield _array("/sim/controller", "controller", trace.controller)


def _legged(trace: Trace) -> Iterator[Column]:
    """What a legged robot senses and is told."""
    measured = cdr.joint_state(trace.joints, velocity=True, effort=True)
    yield Column("/joint_states", measured, (trace.joint_position, trace.joint_velocity, trace.joint_effort))
    rows = np.zeros((len(trace), 37))
    rows[:, :4], rows[:, 13:16], rows[:, 28] = trace.imu[:, [1, 2, 3, 0]], trace.imu[:, 4:], -1.0
    yield Column("/imu", cdr.imu(), (rows,))
    yield _array("/observation/state", "as the policy is given it", trace.state)
    yield _array("/command/joints", " ".join(trace.joints), trace.action)
    yield _targets("/joint_commands", trace.joints, trace.joint_action, torque=trace.torque)


def _targets(topic: str, names: tuple[str, ...], values: Rows, *, torque: bool) -> Column:
    """What joints are sent, as positions, or as efforts where it is torques."""
    return Column(topic, cdr.joint_state(names, position=not torque, velocity=False, effort=torque), (values,))


def _arm(trace: Trace) -> Iterator[Column]:
    """What the reference arm senses and is told."""
    state, environment = trace.state, trace.environment
    joints = cdr.joint_state(JOINT_NAMES, velocity=True, effort=True)
    yield Column("/joint_states", joints, (state[:, :7], trace.joint_velocity, trace.joint_effort))
    yield _array("/ee/measured", " ".join(STATE[7:11]), state[:, 7:11])
    yield _array("/ee/commanded", " ".join(STATE[11:]), state[:, 11:])
    yield _array("/observation/environment", " ".join(ENVIRONMENT), environment)
    yield _array("/command/ee", " ".join(ACTION), trace.action)
    yield _targets("/joint_commands", JOINT_NAMES, trace.joint_action, torque=False)
    yield Column("/observation/object", cdr.pose_stamped(), (_pose(environment[:, :3], environment[:, 3]),))
    yield Column("/observation/target", cdr.pose_stamped(), (_pose(environment[:, 4:], np.zeros(len(trace))),))


def singles(trace: Trace, urdf: bytes | None) -> list[Single]:
    """The robot's description first, then phases where they change and events, in time order."""
    found: list[Single] = []
    for tick, (last, phase) in enumerate(zip((None, *trace.phase), trace.phase, strict=False)):
        if phase != last:
            found.append(Single("/task/phase", tick, cdr.text(phase)))
    for event in trace.events:
        payload = cdr.log(stamp_ns(event.tick, trace.hz), event.level, event.name, event.text)
        found.append(Single("/events", event.tick, payload))
    found.sort(key=lambda single: single.tick)
    description = [Single("/robot_description", 0, cdr.text(urdf.decode()))] if urdf is not None else []
    return description + found


def check_trace(trace: Trace, where: object) -> None:
    """Raise RecordingError naming the first array whose shape is not what Trace promises."""
    m, joints = len(trace), len(trace.joints or JOINT_NAMES)
    widths = (trace.state.shape[1], 0, joints) if trace.joints else (16, 7, 5)
    legged = {"joint_position": (m, joints), "imu": (m, 7)} if trace.joints else {}
    expected = {**{name: (m, width) for name, width in zip(("state", "environment", "action"), widths, strict=True)},
                **{name: (m, joints) for name in ("joint_action", "joint_velocity", "joint_effort")}, **legged,
                "link_poses": (m, len(trace.links), 7),
                "sim_state": (m, *trace.sim_state.shape[1:2]), "controller": (m, *trace.controller.shape[1:2])}
    found = {name: getattr(trace, name).shape for name in expected} | {"phase": (len(trace.phase),)}
    expected["phase"] = (m,)
    for term, values in trace.reward.items():
        found[f"reward[{term}]"], expected[f"reward[{term}]"] = values.shape, (m,)
    for policy, shadow in trace.shadows.items():
        found[f"shadows[{policy}].joint_commands"], expected[f"shadows[{policy}].joint_commands"] = (
            shadow.joint_commands.shape, (m, joints))
        found[f"shadows[{policy}].disagreement"], expected[f"shadows[{policy}].disagreement"] = (
            shadow.disagreement.shape, (m,))
    for name, values in trace.signals.items():
        found[f"signals[{name}]"], expected[f"signals[{name}]"] = values.shape, (m,)
    for name, shape in expected.items():
        if found[name] != shape:
            raise RecordingError(f"trace.{name} has shape {found[name]}, a trace of {m} ticks needs {shape}",
                                 where=where, mend="record one row a tick, in the order of pipeline.frames")
    for event in trace.events:
        if not (0 <= event.tick <= m and 0 <= event.level <= 255):
            raise RecordingError(f"event {event.name!r} has tick {event.tick} and level {event.level}",
                                 where=where, mend=f"use a tick of 0..{m} and a level of rcl_interfaces/msg/Log")


def _array(topic: str, label: str, values: Rows) -> Column:
    return Column(topic, cdr.multi_array(label, values.shape[1]), (values,) if values.shape[1] else ())


def _pose(xyz: Rows, yaw: NDArray[np.float64]) -> Rows:
    """x, y, z and the quaternion x, y, z, w of a turn by yaw about z."""
    nothing = np.zeros_like(yaw)
    return np.column_stack([xyz, nothing, nothing, np.sin(yaw / 2), np.cos(yaw / 2)])
