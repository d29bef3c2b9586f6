"""LeggedDecoder: from the messages of a legged robot's recording back to its trace."""

from typing import override

import numpy as np

from pipeline.recording import cdr
from pipeline.recording.decode import Decoder, joint_names
from pipeline.recording.errors import reading, refuse
from pipeline.trace import Rows, Trace


class LeggedDecoder(Decoder):
    """Reads a robot of any joints; their names stand in the recording and are the same on every topic."""

    @override
    def features(self) -> dict[str, Rows]:
        """A legged robot's recording has none of the arm's.

        Raises:
            RecordingError: always.
        """
        raise refuse("a legged robot's recording has no frames of a dataset", self._where,
                     "read it whole: pipeline.recording.read_episode")

    @override
    def trace(self) -> Trace:
        """Everything, as it was recorded."""
        self._names = self._named("/joint_states")
        position, velocity, effort = self._measured()
        (rows,) = self._series("/imu").floats(cdr.imu(), self._m)
        imu = np.concatenate([rows[:, [3, 0, 1, 2]], rows[:, 13:16]], axis=1)
        state = self._array("/observation/state")
        action = self._array("/command/joints", len(self._names))
        joint_action = self._targets("/joint_commands")
        for topic, values in (("/joint_states", position), ("/imu", imu), ("/observation/state", state),
                              ("/command/joints", action), ("/joint_commands", joint_action)):
            self._check_finite(topic, values)
        links, poses = self._poses()
        terms = [t.removeprefix("/reward/") for t in self._topics if t.startswith("/reward/")]
        return Trace(
            self._episode.control_hz, state, np.zeros((self._m, 0)), action, joint_action, velocity, effort, links,
            poses, self._phases(), {term: self._scalars(f"/reward/{term}") for term in terms},
            self._restorable("/sim/state"), self._restorable("/sim/controller"), self._shadows(), self.events(),
            self._signals(), self._names, self._torque("/joint_commands"), position, imu)

    @override
    def _targets(self, topic: str) -> Rows:
        """Angles or torques, whichever was sent."""
        torque = self._torque(topic)
        return self._joints(topic, position=not torque, velocity=False, effort=torque)[0]

    def _torque(self, topic: str) -> bool:
        """Whether a topic carries efforts rather than positions."""
        series = self._series(topic)
        with reading(series.where, f"message 0 on {topic}"):
            cursor = cdr.Cursor(series.payload(0))
            joint_names(cursor)
            return cursor.u32() == 0

    def _named(self, topic: str) -> tuple[str, ...]:
        series = self._series(topic)
        with reading(series.where, f"message 0 on {topic}"):
            return joint_names(cdr.Cursor(series.payload(0)))
