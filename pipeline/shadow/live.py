"""Candidates beside one robot in real time: asked when it perceives, heard when its next tick is due."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from pipeline.disagreement import disagreement
from pipeline.protocols import Array, Observation
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_rows import Row
from pipeline.recording.ring import RingRecorder
from pipeline.shadow.riders import Riders
from pipeline.shadow.targets import joint_targets

_ONE = np.arange(1)


class Arm(Protocol):
    """A robot built like the reference arm."""

    def would_have_sent(self, action: Array) -> Array:
        """Joint targets [rad] and opening [m] of actions (1, 5) in place of the last one, shape (1, 7)."""
        ...


class LiveShadow:
    """Riders of one robot, tick by tick; every call returns at once, whatever the candidates do.

    Args:
        riders: not patient; the caller ends them.
        robot: what the champion, or a person, drives.
    """

    def __init__(self, riders: Riders, robot: Arm) -> None:
        self._riders, self._robot = riders, robot
        self.answers: Mapping[str, Array] = {}
        """What was answered to the last tick, shape (1, 5) each."""

    def begin(self) -> None:
        """An attempt begins."""
        self._riders.reset(1)

    def offer(self, observation: Observation) -> None:
        """Show what the robot perceives; the command of the tick has been decided."""
        self._riders.offer(observation, _ONE)

    def beside(self, row: Row, recorder: LiveRecorder | RingRecorder, tick: int) -> Row:
        """The row of a tick with what the candidates have answered in time; news of them goes to /events."""
        self.answers = self._riders.answers()
        found = {id: (joint_targets(lambda action, _: self._robot.would_have_sent(action), action, _ONE)[0],
                      float(disagreement(action, row.action[None])[0])) for id, action in self.answers.items()}
        for id, state in self._riders.news():
            recorder.event("shadow", f"{id} {state}", level=30, tick=tick)
        return replace(row, shadows=found)
