"""One tick of a robot as the bytes of all its messages: laid out once, filled in place every tick."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import RecordingError
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.recording import cdr
from pipeline.recording.dialect import JOINT_NAMES
from pipeline.recording.records import MESSAGE_FIELDS, MESSAGE_HEAD, Op

type Vector = NDArray[np.float64]

_NONE = np.zeros(0)


@dataclass(frozen=True, slots=True)
class Row:
    """What one robot perceived and did at one tick; the names and units of pipeline.trace.Trace, without its rows.

    What a robot does not have stays empty, throughout the recording: a real one has no simulator's state.
    """

    state: Vector
    """See pipeline.frames.STATE, shape (16,)."""
    environment: Vector
    """See pipeline.frames.ENVIRONMENT, shape (7,)."""
    action: Vector
    """See pipeline.frames.ACTION, shape (5,)."""
    joint_action: Vector
    """Joint targets that were sent [rad] and opening [m], shape (7,)."""
    joint_velocity: Vector = field(default_factory=_NONE.copy)
    """Shape (7,), or empty where the robot does not measure it."""
    joint_effort: Vector = field(default_factory=_NONE.copy)
    """Shape (7,), or empty where the robot does not measure it."""
    links: tuple[str, ...] = ()
    """Bodies on /tf."""
    link_poses: Vector = field(default_factory=_NONE.copy)
    """x, y, z [m], qw, qx, qy, qz in the world, shape (len(links), 7)."""
    reward: Mapping[str, float] = field(default_factory=dict[str, float])
    """Reward term -> value."""
    shadows: Mapping[str, tuple[Vector, float]] = field(default_factory=dict[str, tuple[Vector, float]])
    """Policy that may not act -> joint targets it asked for, shape (7,), and its disagreement; see trace.Shadow."""
    sim_state: Vector = field(default_factory=_NONE.copy)
    """mjSTATE_INTEGRATION before the action of the tick, shape (nstate,)."""
    controller: Vector = field(default_factory=_NONE.copy)
    """The rest of what a restore needs, shape (k,)."""
    signals: Mapping[str, float] = field(default_factory=dict[str, float])
    """What was computed of the risk, see pipeline.signals -> value, NaN where it is not known."""

    def vector(self) -> Vector:
        """Every number in one new array: the caller may go on writing into its own."""
        shadows = [np.append(asked, apart) for asked, apart in self.shadows.values()]
        return np.concatenate([
            self.state, self.environment, self.action, self.joint_action, self.joint_velocity, self.joint_effort,
            self.link_poses.reshape(-1), [*self.reward.values()], *shadows, [*self.signals.values()],
            self.sim_state, self.controller],
            dtype=np.float64)

    @property
    def names(self) -> tuple[str, ...]:
        """Links, rewards, shadows and signals, which may not change from tick to tick."""
        return (*self.links, *self.reward, *self.shadows, *self.signals)


class TickLayout:
    """All messages of a tick as one template; `block` fills it.

    Args:
        columns: topic, its layout, and which entries of the tick's vector fill the layout's floats, in order.
    """

    def __init__(self, columns: Sequence[tuple[str, cdr.Layout, Sequence[int] | NDArray[np.intp]]]) -> None:
        template, stamps, floats, self._heads = bytearray(), list[int](), list[int](), list[int]()
        for _, layout, _ in columns:
            self._heads.append(len(template))
            template += MESSAGE_HEAD.pack(Op.MESSAGE, MESSAGE_FIELDS + len(layout.template), 0, 0, 0, 0)
            payload = len(template)
            template += layout.template
            stamps += [payload + at for at in layout.stamps]
            floats += [payload + at + 8 * k for at, count in layout.floats for k in range(count)]
        self.topics = tuple(topic for topic, _, _ in columns)
        self.names: tuple[str, ...] = ()
        """Links, rewards and shadows of the arm's ticks."""
        self._template = np.frombuffer(bytes(template), np.uint8).copy()
        self._head_bytes = _spread(np.array(self._heads, np.intp) + 11, 20)
        self._stamp_bytes = _spread(np.array(stamps, np.intp), 8)
        self._float_bytes = _spread(np.array(floats, np.intp), 8)
        self._entries = np.concatenate([np.asarray(entries, np.intp) for _, _, entries in columns])
        if len(self._entries) != len(floats):
            raise ValueError(f"{len(self._entries)} entries for {len(floats)} numbers")
        self.shape = (int(self._entries.max()) + 1,)
        """Shape of a tick's vector."""
        self.places: list[tuple[int, int]] = []

    def number(self, numbers: Sequence[int]) -> None:
        """Write the channel numbers of the topics into the template."""
        for at, number in zip(self._heads, numbers, strict=True):
            self._template[at + 9 : at + 11] = np.frombuffer(number.to_bytes(2, "little"), np.uint8)
        self.places = list(zip(numbers, self._heads, strict=True))

    def block(self, tick: int, log_ns: int, stamp_ns: int, values: Vector) -> bytes:
        """The records of one tick.

        Args:
            tick: sequence number of every message.
            log_ns: when it was recorded [ns].
            stamp_ns: when it happened: publish time and header stamps [ns].
            values: the tick's vector, of which the layout's entries are taken.
        """
        block = self._template.copy()
        head = tick.to_bytes(4, "little") + log_ns.to_bytes(8, "little") + stamp_ns.to_bytes(8, "little")
        block[self._head_bytes] = np.frombuffer(head, np.uint8)
        if len(self._stamp_bytes):
            seconds, rest = divmod(stamp_ns, 1_000_000_000)
            stamp = seconds.to_bytes(4, "little") + rest.to_bytes(4, "little")
            block[self._stamp_bytes] = np.frombuffer(stamp, np.uint8)
        block[self._float_bytes] = values[self._entries].view(np.uint8).reshape(-1, 8)
        return block.tobytes()


def _spread(starts: NDArray[np.intp], size: int) -> NDArray[np.intp]:
    """Places of every byte of equal fields, shape (len(starts), size)."""
    return starts.reshape(-1, 1) + np.arange(size)


def joint_layout(names: Sequence[str], *, velocity: bool = False, effort: bool = False) -> TickLayout:
    """A tick of a robot with any joints: measured positions, velocities, efforts on /joint_states, then the targets
    that were sent on /joint_commands; the vector holds them in this order.
    """
    parts, n = 1 + velocity + effort, len(names)
    return TickLayout([
        ("/joint_states", cdr.joint_state(names, velocity=velocity, effort=effort), np.arange(parts * n)),
        ("/joint_commands", cdr.joint_state(names, velocity=False, effort=False), np.arange(n) + parts * n)])


def joint_targets(names: Sequence[str], values: Vector, ns: int) -> bytes:
    """One sensor_msgs/JointState of positions, shape (len(names),), stamped `ns`."""
    layout = cdr.joint_state(names, velocity=False, effort=False)
    payload = bytearray(layout.template)
    struct.pack_into("<iI", payload, layout.stamps[0], *divmod(ns, 1_000_000_000))
    for offset, count in layout.floats:
        struct.pack_into(f"<{count}d", payload, offset, *values)
    return bytes(payload)


class RowLayout(TickLayout):
    """The reference arm's tick: the topics of columns.py, in their order, from a Row's vector."""

    def __init__(self, row: Row, where: object) -> None:
        check_row(row, where)
        sizes = [16, 7, 5, 7, len(row.joint_velocity), len(row.joint_effort), row.link_poses.size, len(row.reward),
                 8 * len(row.shadows), len(row.signals), len(row.sim_state), len(row.controller)]
        edges = list(accumulate(sizes, initial=0))
        state, seen, action, sent, velocity, effort, poses, rewards, shadows, risk, sim, memory = (
            np.arange(a, b, dtype=np.intp) for a, b in pairwise(edges))
        self._yaw = int(seen[3])
        zero, sine, cosine, one = (edges[-1] + k for k in range(4))
        joints = cdr.joint_state(JOINT_NAMES, velocity=len(velocity) > 0, effort=len(effort) > 0)
        columns: list[tuple[str, cdr.Layout, Sequence[int] | NDArray[np.intp]]] = [
            ("/joint_states", joints, np.concatenate([state[:7], velocity, effort])),
            _array("/ee/measured", " ".join(STATE[7:11]), state[7:11]),
            _array("/ee/commanded", " ".join(STATE[11:]), state[11:]),
            _array("/observation/environment", " ".join(ENVIRONMENT), seen),
            _array("/command/ee", " ".join(ACTION), action),
            ("/joint_commands", cdr.joint_state(JOINT_NAMES, velocity=False, effort=False), sent),
            ("/observation/object", cdr.pose_stamped(), [*map(int, seen[:3]), zero, zero, sine, cosine]),
            ("/observation/target", cdr.pose_stamped(), [*map(int, seen[4:]), zero, zero, zero, one])]
        if row.links:
            xyzw = poses.reshape(-1, 7)[:, [0, 1, 2, 4, 5, 6, 3]]
            columns.append(("/tf", cdr.tf_message(row.links), xyzw.reshape(-1)))
        columns += [(f"/reward/{term}", cdr.float64(), [int(at)])
                    for term, at in zip(row.reward, rewards, strict=True)]
        for policy, own in zip(row.shadows, shadows.reshape(-1, 8), strict=True):
            asked = cdr.joint_state(JOINT_NAMES, velocity=False, effort=False)
            columns += [(f"/policy/{policy}/joint_commands", asked, own[:7]),
                        (f"/policy/{policy}/disagreement", cdr.float64(), own[7:])]
        columns += [(f"/signal/{name}", cdr.float64(), [int(at)]) for name, at in zip(row.signals, risk, strict=True)]
        if len(sim):
            columns += [_array("/sim/state", "mjSTATE_INTEGRATION", sim),
                        _array("/sim/controller", "controller", memory)]
        super().__init__(columns)
        self.shape, self.names = (edges[-1],), row.names

    def block(self, tick: int, log_ns: int, stamp_ns: int, values: Vector) -> bytes:
        """See TickLayout; the quaternions that viewers want are worked out here, off the control thread."""
        half = values[self._yaw] / 2
        return super().block(tick, log_ns, stamp_ns, np.append(values, [0.0, np.sin(half), np.cos(half), 1.0]))


def check_row(row: Row, where: object) -> None:
    """Raise RecordingError naming the first part whose shape is not what Row promises."""
    expected = {"state": {(16,)}, "environment": {(7,)}, "action": {(5,)}, "joint_action": {(7,)},
                "joint_velocity": {(7,), (0,)}, "joint_effort": {(7,), (0,)},
                "link_poses": {(len(row.links), 7)} if row.links else {(0,)}}
    for name, shapes in expected.items():
        found = getattr(row, name).shape
        if found not in shapes:
            raise RecordingError(f"row.{name} has shape {found}, a tick of the arm needs {max(shapes)}", where=where,
                                 mend="give one tick of one robot, in the order of pipeline.frames")


def _array(topic: str, label: str, entries: NDArray[np.intp]) -> tuple[str, cdr.Layout, NDArray[np.intp]]:
    return topic, cdr.multi_array(label, len(entries)), entries
