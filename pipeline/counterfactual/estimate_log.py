"""SensedLog: what a real robot knows of an attempt. The state is estimated from this and from nothing else."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from pipeline.errors import RecordingError
from pipeline.frames import ENVIRONMENT, JOINTS, STATE
from pipeline.protocols import Array
from pipeline.simulation.physics import MAX_DELAY
from pipeline.simulation.tasks import load_task
from pipeline.trace import Trace
from pipeline.triggers import stratum_of
from schemas.scene import SceneSpec

TOOL = slice(STATE.index("ee_x"), STATE.index("ee_z") + 1)
TOOL_YAW, OPENING, ASKED = STATE.index("ee_yaw"), STATE.index("gripper"), STATE.index("cmd_gripper")
CLOSING_M = 0.04
"""Opening below which the fingers were asked to close [m]."""
POSE = slice(STATE.index("cmd_x"), STATE.index("cmd_yaw") + 1)


@dataclass(frozen=True, slots=True)
class SensedLog:
    """One attempt as its robot sensed it; m ticks. There is no field for anything that only a simulator knows."""

    state: Array
    """See pipeline.frames.STATE: encoders, forward kinematics, own command, shape (m, 16)."""
    environment: Array
    """See pipeline.frames.ENVIRONMENT: the object as perceived, off by a bias and by noise, shape (m, 7)."""
    action: Array
    """See pipeline.frames.ACTION, shape (m, 5)."""
    joint_action: Array
    """Joint targets sent [rad] and opening [m], shape (m, 7)."""
    joint_velocity: Array
    """Measured [rad/s] and opening speed [m/s], shape (m, 7)."""
    phase: tuple[str, ...]
    """Subtask at each tick, as the robot itself told it."""

    @classmethod
    def of(cls, trace: Trace, where: object) -> Self:
        """Take what was sensed out of a recording, and nothing else.

        Args:
            trace: of the reference arm.
            where: the recording, for errors.

        Raises:
            RecordingError: the robot senses something else, or a value is not finite.
        """
        log = cls(trace.state, trace.environment, trace.action, trace.joint_action, trace.joint_velocity, trace.phase)
        for name, array, wide in (("observation.state", log.state, len(STATE)),
                                  ("observation.environment_state", log.environment, len(ENVIRONMENT)),
                                  ("action", log.action, 5), ("action.joint", log.joint_action, len(JOINTS) + 1),
                                  ("joint velocity", log.joint_velocity, len(JOINTS) + 1)):
            if array.shape != (len(log), wide) or not np.isfinite(array).all():
                raise RecordingError(f"{name} is not {wide} finite values a tick", where=where,
                                     mend="estimate from recordings of an arm that measures its joints and perceives "
                                          "its object")
        return log

    def __len__(self) -> int:
        return len(self.state)

    @property
    def joints(self) -> Array:
        """Measured joints [rad] and opening [m], shape (m, 7)."""
        return self.state[:, :OPENING + 1]

    @property
    def sent(self) -> Array:
        """What the servos were asked for [rad] and half the opening [m], shape (MAX_DELAY + 1 + m, 7).

        Row MAX_DELAY + 1 + k holds what was sent after tick k; before the first tick the robot stood where it was.
        """
        first = np.append(self.state[0, :len(JOINTS)], self.state[0, ASKED])
        rows = np.concatenate([np.tile(first, (MAX_DELAY + 1, 1)), self.joint_action])
        return rows * np.array([*[1.0] * len(JOINTS), 0.5])


def perceived_scene(scene: SceneSpec, log: SensedLog, seed: int) -> SceneSpec:
    """The start of an attempt as its robot perceived it.

    Args:
        scene: as recorded; only its robot, its surroundings and its task are read.
        log: of the attempt.
        seed: of the noise of whatever is played from it.
    """
    x, y, z, yaw, to_x, to_y = (float(v) for v in log.environment[0, :6])
    return SceneSpec(family="study", seed=seed, robot=scene.robot, scene=scene.scene, task=scene.task,
                     stratum=stratum_of(log.environment[0]), object_xy_m=(x, y), object_yaw_rad=yaw,
                     object_half_m=load_task(scene.task).nearest_half(z), target_xy_m=(to_x, to_y))
