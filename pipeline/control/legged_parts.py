"""Parts of legged hierarchies: courses above; a trained policy below."""

from pathlib import Path

import numpy as np

from pipeline.control.config import CourseConfig
from pipeline.control.legged import LeggedPlant, LeggedSensed
from pipeline.control.parts import Forgetful, Memory
from pipeline.errors import PolicyError
from pipeline.locomotion.tasks import LeggedTask
from pipeline.locomotion.world import LeggedWorld
from pipeline.ppo.runner import OnnxRunner
from pipeline.protocols import Array


class Profile(Forgetful):
    """The upper that asks for a speed by the clock, and to look where the robot looked at the beginning."""

    def __init__(self, course: CourseConfig) -> None:
        self._times: Array = np.array([time for time, _ in course.profile], np.float64)
        self._speeds: Array = np.array([speed for _, speed in course.profile], np.float64)
        self._course = course

    def command(self, sensed: LeggedSensed, time_s: float) -> Array:
        """Forward, left [m/s], turning [rad/s], shape (n, 3)."""
        forward: Array = np.zeros(len(sensed.heading)) + float(np.interp(time_s, self._times, self._speeds))
        return np.column_stack([forward, np.zeros_like(forward), turning(-sensed.heading, self._course)])


class Waypoints:
    """The upper that leads from one waypoint to the next.

    Args:
        course: where to, and how fast.
        n: how many robots.
        turns: go forward as far as a robot looks that way, and turn towards it; or look where it looked at the
            beginning, and go forward and sideways.
    """

    def __init__(self, course: CourseConfig, n: int, *, turns: bool) -> None:
        self._course, self._points, self._turns = course, np.array(course.waypoints, np.float64), turns
        self._start = np.full((n, 2), np.nan)
        self.reached = np.zeros(n)
        """Waypoints that each robot has reached, shape (n,)."""

    def command(self, sensed: LeggedSensed, time_s: float) -> Array:
        """Forward, left [m/s], turning [rad/s], shape (n, 3); zero from the last waypoint on."""
        course, last = self._course, len(self._points)
        if np.isnan(self._start).any():
            self._start = sensed.position.copy()
        way = self._way(sensed)
        self.reached += (self.reached < last) & (np.linalg.norm(way, axis=1) < course.within_m)
        way = self._way(sensed)
        angle = wrapped(np.arctan2(way[:, 1], way[:, 0]) - sensed.heading)
        forward, left = course.speed_m_s * np.cos(angle), course.speed_m_s * np.sin(angle)
        if self._turns:
            command = np.column_stack([np.maximum(0.0, forward), np.zeros_like(left), turning(angle, course)])
        else:
            command = np.column_stack([forward, left, turning(-sensed.heading, course)])
        return np.where((self.reached < last)[:, None], command, 0.0)

    def _way(self, sensed: LeggedSensed) -> Array:
        """From each robot to its next waypoint [m], shape (n, 2)."""
        following = np.minimum(self.reached, len(self._points) - 1).astype(int)
        return self._start + self._points[following] - sensed.position

    def save(self) -> Memory:
        """Where the course begins, and how far each robot has come."""
        return {"start": self._start.copy(), "reached": self.reached.copy()}

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        self._start, self.reached = memory["start"].copy(), memory["reached"].copy()


def wrapped(angle: Array) -> Array:
    """The same angles within half a turn [rad]."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def turning(angle: Array, course: CourseConfig) -> Array:
    """Turning asked for [rad/s] where an angle is missing [rad]."""
    return np.clip(course.turn_1_s * angle, -course.turn_rad_s, course.turn_rad_s)


class Trained(Forgetful):
    """The lower that asks a trained policy, at the command it is given.

    A command beyond what the policy was trained for is cut to it: a policy that never turned is not asked to turn.

    Args:
        path: the ONNX file.
        plant: the robots it shall drive.

    Raises:
        PolicyError: no policy of a legged robot, or one of another body or another kind of observation.
    """

    def __init__(self, path: Path, plant: LeggedPlant) -> None:
        self._runner, self._joints = OnnxRunner(path), len(plant.body.joints)
        if (self._runner.width, self._runner.joints) != (plant.world.width, self._joints):
            raise PolicyError(f"policy reads {self._runner.width} values and moves {self._runner.joints} joints, the "
                              f"robot has {plant.world.width} and {self._joints}", where=path,
                              mend="give a policy of this body and task: hardcase rl train --body BODY --task walk")
        self.limits: Array = np.array(LeggedTask.model_validate_json(self._runner.facts["task"]).command, np.float64)
        """Smallest and largest of each command that the policy was trained for, shape (3, 2)."""

    def act(self, command: Array, sensed: LeggedSensed) -> Array:
        """Shares in [-1, 1], shape (n, joints)."""
        seen = sensed.observation.copy()
        at = LeggedWorld.command_at(self._joints)
        seen[:, at] = np.clip(command, *self.limits.T)
        return self._runner(seen)
