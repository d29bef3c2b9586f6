"""Frames: the dataset features of one episode as arrays, and their names, shapes and units."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import RecordingError

JOINTS = ("joint1", "joint2", "joint3", "joint4", "joint5", "joint6")
"""Joint names of the reference arm, base to wrist [rad]."""

STATE = (*JOINTS, "gripper", "ee_x", "ee_y", "ee_z", "ee_yaw", "cmd_x", "cmd_y", "cmd_z", "cmd_yaw", "cmd_gripper")
"""observation.state: measured joints [rad], finger opening [m], measured end-effector pose by forward
kinematics of the measured joints [m, rad], and the last commanded pose [m, rad] and opening [m]."""

ENVIRONMENT = ("object_x", "object_y", "object_z", "object_yaw", "target_x", "target_y", "target_z")
"""observation.environment_state, as perceived, bias and noise included [m, rad]."""

ACTION = ("dx", "dy", "dz", "dyaw", "gripper")
"""action: motion relative to the last commanded pose [m, rad] and finger opening asked for [m]."""

type Features = Mapping[str, tuple[str, ...]]
"""Feature name -> names of its values, in the column order of a dataset version."""

FEATURES: Features = MappingProxyType({
    "observation.state": STATE,
    "observation.environment_state": ENVIRONMENT,
    "action": ACTION,
    "action.joint": (*JOINTS, "gripper"),
})
"""The features of the reference arm."""


class Table(Protocol):
    """One episode of some robot on its control clock: what a dataset version takes."""

    @property
    def names(self) -> Features:
        """The features that it has."""
        ...

    def __len__(self) -> int:
        """How many frames."""
        ...

    def columns(self) -> dict[str, NDArray[np.float32]]:
        """Feature name -> array (frames, values), in the order of `names`."""
        ...


@dataclass(frozen=True, slots=True)
class FeatureTable:
    """One episode of any robot, with the features that were declared for it."""

    names: Features
    values: Mapping[str, NDArray[np.float32]]
    """Feature name -> array (frames, values); the same keys as `names`."""

    def __len__(self) -> int:
        return len(next(iter(self.values.values())))

    def columns(self) -> dict[str, NDArray[np.float32]]:
        """Feature name -> array, in the order of `names`."""
        return {name: self.values[name] for name in self.names}


@dataclass(frozen=True, slots=True)
class Frames:
    """One episode on its control clock; row k of the action is sent after row k is seen."""

    state: NDArray[np.float32]
    """observation.state, shape (m, 16)."""
    environment: NDArray[np.float32]
    """observation.environment_state, shape (m, 7)."""
    action: NDArray[np.float32]
    """action, shape (m, 5)."""
    joint_action: NDArray[np.float32]
    """action.joint: joint targets that were sent [rad] and opening [m], shape (m, 7)."""

    def __len__(self) -> int:
        return len(self.state)

    @property
    def names(self) -> Features:
        """The features of the reference arm."""
        return FEATURES

    def columns(self) -> dict[str, NDArray[np.float32]]:
        """Feature name -> array, in the order of FEATURES."""
        return dict(zip(FEATURES, (self.state, self.environment, self.action, self.joint_action), strict=True))

    def check(self, where: object) -> "Frames":
        """Return self, or raise RecordingError naming the first wrong shape or value that is not finite."""
        check_table(self, where)
        return self


def check_table(table: Table, where: object, robot: str | None = None) -> None:
    """Raise RecordingError naming the first wrong shape or value that is not finite, and `robot` if it is known."""
    expects = "the robot" if robot is None else f"robot {robot!r}"
    for (name, names), array in zip(table.names.items(), table.columns().values(), strict=True):
        if array.shape != (len(table), len(names)):
            raise RecordingError(f"{name} has {array.shape[-1]} values, {expects} expects {len(names)}",
                                 where=where, mend="record with the robot that the recipe names")
        if not np.isfinite(array).all():
            row, column = (int(i) for i in np.argwhere(~np.isfinite(array))[0])
            raise RecordingError(f"{name}[{column}] is {array[row, column]} at frame {row}",
                                 where=where, mend="drop the episode: it cannot be trained on")
