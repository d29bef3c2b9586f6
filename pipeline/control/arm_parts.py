"""Parts of the arm's hierarchies: goals and paths above; inverse kinematics and predictive sampling below."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

import numpy as np

from pipeline.control.arm import ArmPlant, ArmSensed
from pipeline.control.config import IkConfig
from pipeline.control.parts import Forgetful, Lower, Memory
from pipeline.protocols import Array

NEAR_M = 0.03
"""A standing error is integrated only this close to the command: on the way there is no standing error."""
LARGEST_TRIM_M = 0.03
PATH_M_S = 0.4
"""Mean speed along a path."""


class Target(Forgetful):
    """The upper that names the goal at once."""

    def __init__(self, goals: Array) -> None:
        self._goals = goals

    def command(self, sensed: ArmSensed, time_s: float) -> Array:
        """The goal, whenever it is asked."""
        return self._goals


class StraightPath:
    """The upper that leads to the goal on a straight line, from rest to rest.

    Along the line s = 10 t^3 - 15 t^4 + 6 t^5, the curve of least jerk (Flash and Hogan 1985, J. Neuroscience 5:1688).

    Args:
        goals: x, y, z [m], yaw [rad], shape (n, 4).
    """

    def __init__(self, goals: Array) -> None:
        self._goals, self._start = goals, np.full_like(goals, np.nan)

    def command(self, sensed: ArmSensed, time_s: float) -> Array:
        """Where on the line the hand is to be now."""
        if np.isnan(self._start).any():
            self._start = sensed.tool.copy()
        whole = self._goals - self._start
        takes = np.maximum(np.linalg.norm(whole[:, :3], axis=1), 0.05) / PATH_M_S
        t = np.clip(time_s / takes, 0.0, 1.0)[:, None]
        return self._start + (10 * t**3 - 15 * t**4 + 6 * t**5) * whole

    def save(self) -> Memory:
        """Where the line begins."""
        return {"start": self._start.copy()}

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        self._start = memory["start"].copy()


class Ik:
    """The lower that solves for joints: a pose runs ahead of the hand towards the command, its joints are the action.

    It starts from the joints commanded last, not from those measured: a servo's standing error is not fed back.

    Args:
        plant: the arms, whose nominal kinematics it knows.
        config: how fast the pose runs.
        lower_hz: how often it is asked to act [Hz].
    """

    def __init__(self, plant: ArmPlant, config: IkConfig, *, lower_hz: float) -> None:
        self._kinematics = plant.kinematics
        self._joints: Array = np.repeat(plant.home[None], plant.n, axis=0)
        self._pose = self._kinematics.xyz_yaw(self._joints)
        self._step_m, self._step_rad = config.speed_m_s / lower_hz, config.turn_rad_s / lower_hz

    def act(self, command: Array, sensed: ArmSensed) -> Array:
        """Joint targets [rad], shape (n, 6)."""
        way = command - self._pose
        length = np.linalg.norm(way[:, :3], axis=1, keepdims=True)
        self._pose[:, :3] += way[:, :3] * np.minimum(1.0, self._step_m / np.maximum(length, 1e-12))
        self._pose[:, 3] += np.clip(way[:, 3], -self._step_rad, self._step_rad)
        self._joints = self._kinematics.towards(self._joints, self._pose)
        return self._joints

    def save(self) -> Memory:
        """Pose and joints that were solved for last."""
        return {"pose": self._pose.copy(), "joints": self._joints.copy()}

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        self._pose, self._joints = memory["pose"].copy(), memory["joints"].copy()


class Trimmed:
    """Any lower of the arm, with the hand's standing error added up and asked for on top.

    Args:
        lower: gets the command plus the trim.
        n: how many arms.
        rate_1_s: how fast an error is added up [1/s].
        lower_hz: how often it is asked to act [Hz].
    """

    def __init__(self, lower: Lower[ArmSensed], n: int, rate_1_s: float, *, lower_hz: float) -> None:
        self._lower, self._share = lower, rate_1_s / lower_hz
        self._trim = np.zeros((n, 4))

    def act(self, command: Array, sensed: ArmSensed) -> Array:
        """What the lower does for the trimmed command."""
        error = command - sensed.tool
        near = np.linalg.norm(error[:, :3], axis=1, keepdims=True) < NEAR_M
        self._trim[:, :3] += np.where(near, self._share * error[:, :3], 0.0)
        np.clip(self._trim, -LARGEST_TRIM_M, LARGEST_TRIM_M, out=self._trim)
        return self._lower.act(command + self._trim, sensed)

    def save(self) -> Memory:
        """The trim, and what the lower remembers."""
        return {"trim": self._trim.copy(), **self._lower.save()}

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        self._trim = memory["trim"].copy()
        self._lower.load({key: values for key, values in memory.items() if key != "trim"})
