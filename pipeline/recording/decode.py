"""From messages back to arrays: what a dataset needs, and the whole of a trace."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.recording import cdr
from pipeline.recording.dialect import FRAME_TOPICS, JOINT_NAMES, RESTORE_TOPICS, every_tick, topic_type
from pipeline.recording.scan import reading, refuse
from pipeline.recording.series import Series
from pipeline.trace import Event, Rows, Shadow, Trace
from schemas.episode import Episode

_FEATURES: Mapping[str, tuple[str, int]] = {
    "/joint_states": ("observation.state", 0),
    "/ee/measured": ("observation.state", 7),
    "/ee/commanded": ("observation.state", 11),
    "/observation/environment": ("observation.environment_state", 0),
    "/command/ee": ("action", 0),
    "/joint_commands": ("action.joint", 0),
    "/observation/state": ("observation.state", 0),
    "/command/joints": ("action", 0),
    "/imu": ("imu", 0),
}
"""Topic -> the dataset feature it carries, and its first column there."""


class Decoder:
    """Reads the first `m` ticks of a recording's topics, each checked against what the robot must have."""

    def __init__(self, topics: Mapping[str, Series], episode: Episode, m: int, where: Path) -> None:
        self._topics, self._episode, self._m, self._where = topics, episode, m, where
        self._names: tuple[str, ...] = JOINT_NAMES

    @property
    def topics(self) -> Mapping[str, Series]:
        """The topics that were read, with stamps and payloads, for those who need more than a dataset or a trace."""
        return self._topics

    def features(self) -> dict[str, Rows]:
        """observation.state, observation.environment_state, action, action.joint, and velocity and effort, float64."""
        state, velocity, effort = self._measured()
        measured = self._array("/ee/measured", len(STATE[7:11]))
        commanded = self._array("/ee/commanded", len(STATE[11:]))
        environment = self._array("/observation/environment", len(ENVIRONMENT))
        action = self._array("/command/ee", len(ACTION))
        joint_action = self._targets("/joint_commands")
        for topic, values in zip(FRAME_TOPICS, (state, measured, commanded, environment, action, joint_action),
                                 strict=True):
            self._check_finite(topic, values)
        return {"state": np.concatenate([state, measured, commanded], axis=1), "environment": environment,
                "action": action, "joint_action": joint_action, "velocity": velocity, "effort": effort}

    def trace(self) -> Trace:
        """Everything, as it was recorded."""
        found = self.features()
        links, poses = self._poses()
        terms = [t.removeprefix("/reward/") for t in self._topics if t.startswith("/reward/")]
        return Trace(
            self._episode.control_hz, found["state"], found["environment"], found["action"], found["joint_action"],
            found["velocity"], found["effort"], links, poses, self._phases(),
            {term: self._scalars(f"/reward/{term}") for term in terms},
            self._restorable("/sim/state"), self._restorable("/sim/controller"), self._shadows(), self.events(),
            self._signals())

    def _series(self, topic: str) -> Series:
        series = self._topics.get(topic)
        if series is None:
            raise refuse(f"topic {topic} is missing beside its sisters", self._where,
                         "record all topics of a policy, or none")
        if series.type != topic_type(topic):
            raise refuse(f"{topic} is of type {series.type!r}, the dialect says {topic_type(topic)!r}", series.where,
                         "record it in the dialect of pipeline/recording/dialect.py")
        return series

    def _measured(self) -> list[Rows]:
        """Positions, velocities and efforts, shape (m, 7) each; NaN where the robot does not measure them."""
        series, has = self._series("/joint_states"), list[bool]()
        with reading(series.where, "message 0 on /joint_states"):
            cursor = cdr.Cursor(series.payload(0))
            joint_names(cursor)
            for _ in range(3):
                has.append((width := _count(cursor)) > 0)
                cursor.floats(width)
        found = iter(self._joints("/joint_states", velocity=has[1], effort=has[2]))
        return [next(found) if present else np.full((self._m, len(self._names)), np.nan)
                for present in (True, *has[1:])]

    def _restorable(self, topic: str) -> Rows:
        """What a simulator saved; a real robot saves nothing, shape (m, 0)."""
        if any(name in self._topics for name in RESTORE_TOPICS):
            return self._array(topic)
        return np.zeros((self._m, 0))

    def _targets(self, topic: str) -> Rows:
        """What joints were sent, shape (m, j)."""
        return self._joints(topic, velocity=False, effort=False)[0]

    def _joints(self, topic: str, *, velocity: bool, effort: bool, position: bool = True) -> list[Rows]:
        series = self._series(topic)
        with reading(series.where, f"message 0 on {topic}"):
            names = joint_names(cdr.Cursor(series.payload(0)))
        self._check_width(topic, len(names), len(self._names))
        if names != self._names:
            raise refuse(f"{topic} names joints {', '.join(names)}", series.where,
                         f"record {', '.join(self._names)} in this order")
        return series.floats(cdr.joint_state(names, position=position, velocity=velocity, effort=effort), self._m)

    def _array(self, topic: str, width: int | None = None) -> Rows:
        series = self._series(topic)
        with reading(series.where, f"message 0 on {topic}"):
            cursor = cdr.Cursor(series.payload(0))
            label = ""
            if dimensions := _count(cursor):
                label, _, _ = cursor.text(), cursor.u32(), cursor.u32()
            cursor.u32()
            found = cursor.u32()
            if dimensions != 1:
                raise ValueError(f"{dimensions} dimensions, one is expected")
            cursor.floats(found)
        if width is not None:
            self._check_width(topic, found, width)
        runs = series.floats(cdr.multi_array(label, found), self._m)
        return runs[0] if runs else np.zeros((self._m, 0))

    def _scalars(self, topic: str) -> Rows:
        return self._series(topic).floats(cdr.float64(), self._m)[0][:, 0]

    def _poses(self) -> tuple[tuple[str, ...], Rows]:
        if "/tf" not in self._topics:
            return (), np.zeros((self._m, 0, 7))
        series = self._series("/tf")
        with reading(series.where, "message 0 on /tf"):
            cursor = cdr.Cursor(series.payload(0))
            links: list[str] = []
            for _ in range(_count(cursor)):
                cursor.stamp()
                cursor.text()
                links.append(cursor.text())
                cursor.floats(7)
        if not links:
            return (), np.zeros((self._m, 0, 7))
        runs = series.floats(cdr.tf_message(links), self._m)
        return tuple(links), np.stack(runs, axis=1)[:, :, [0, 1, 2, 6, 3, 4, 5]]

    def _phases(self) -> tuple[str, ...]:
        phases = [""] * self._m
        if series := self._topics.get("/task/phase"):
            for k, tick in enumerate(series.ticks()):
                with reading(series.where, f"message {k} on /task/phase"):
                    name = cdr.Cursor(series.payload(k)).text()
                phases[tick:] = [name] * len(phases[tick:])
        return tuple(phases)

    def events(self) -> tuple[Event, ...]:
        """Everything on /events up to the last tick."""
        found: list[Event] = []
        if series := self._topics.get("/events"):
            for k, tick in enumerate(series.ticks()):
                with reading(series.where, f"message {k} on /events"):
                    cursor = cdr.Cursor(series.payload(k))
                    cursor.stamp()
                    found.append(Event(int(tick), cursor.u8(), cursor.text(), cursor.text()))
        return tuple(event for event in found if event.tick <= self._m)

    def _shadows(self) -> dict[str, Shadow]:
        ids = [t.split("/")[2] for t in self._topics if t.startswith("/policy/") and t.endswith("/joint_commands")]
        return {i: Shadow(self._targets(f"/policy/{i}/joint_commands"),
                          self._scalars(f"/policy/{i}/disagreement")) for i in ids}

    def _signals(self) -> dict[str, Rows]:
        return {topic.removeprefix("/signal/"): self._scalars(topic)
                for topic in self._topics if topic.startswith("/signal/")}

    def _check_width(self, topic: str, found: int, expected: int) -> None:
        if found != expected:
            name = _FEATURES.get(topic, (topic, 0))[0]
            raise refuse(f"{name} has {found} values, robot {self._episode.scene.robot!r} expects {expected}",
                         f"{self._topics[topic].where}, {topic}", "record with the robot that the recipe names")

    def _check_finite(self, topic: str, values: NDArray[np.float64]) -> None:
        if not np.isfinite(values).all():
            row, column = (int(i) for i in np.argwhere(~np.isfinite(values))[0])
            name, first = _FEATURES[topic]
            what = "NaN" if np.isnan(values[row, column]) else "Inf"
            raise refuse(f"{name}[{first + column}] is {what} at frame {row}, {topic}", self._topics[topic].where,
                         "drop the episode: it cannot be trained on")


def whole_ticks(topics: Mapping[str, Series], required: tuple[str, ...], episode: Episode, *,
                where: object, exact: bool) -> tuple[int, str | None]:
    """How many ticks every required and every per-tick topic holds, and the first gap that ends them, if one does.

    Args:
        topics: what was read; their steps count 0, 1, 2, ...
        required: topics without which the recording is of no use.
        episode: names the robot whose contract is checked.
        where: the file.
        exact: all must hold one message for every frame of the episode, and a gap is an error.
    """
    for topic in required:
        if topic not in topics:
            raise refuse(f"topic {topic}, required by contract {episode.scene.robot!r}, is missing", where,
                         "record it, or name another robot in the recipe")
    counts, gap = dict[str, int](), None
    for topic, series in topics.items():
        if not every_tick(topic):
            continue
        counts[topic] = len(series)
        wrong = np.flatnonzero(series.ticks() != np.arange(len(series)))
        if wrong.size:
            k = counts[topic] = int(wrong[0])
            gap = f"{topic} skips to tick {series.ticks()[k]} at message {k}"
            if exact:
                raise refuse(gap, where, "record every tick, or keep what is before it: --accept-truncated")
    if exact:
        for topic, count in counts.items():
            if count != episode.frames:
                raise refuse(f"{topic} has {count} messages, the episode {episode.frames} frames", where,
                             "record every topic at every tick, or drop the episode")
    return min(counts.values(), default=0), gap


def joint_names(cursor: cdr.Cursor) -> tuple[str, ...]:
    """Names in a JointState; the cursor stands before its positions afterwards."""
    cursor.stamp()
    cursor.text()
    return tuple(cursor.text() for _ in range(_count(cursor)))


def _count(cursor: cdr.Cursor) -> int:
    """Length of a sequence; more than a robot can have is refused before anything is made of it."""
    count = cursor.u32()
    if count > 10_000:
        raise ValueError(f"sequence of {count}")
    return count

