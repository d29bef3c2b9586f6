"""A robot of LeRobot that is built like the reference arm: the same joints, so the same actions, policies and data."""

# mujoco is a compiled package without type stubs: a compiled model has no type that a checker knows
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import ENVIRONMENT, JOINTS
from pipeline.protocols import Array, Ids, Observation, Signals
from pipeline.recording.dialect import JOINT_NAMES
from pipeline.recording.live_rows import Row, TickLayout, joint_layout
from pipeline.robots.judging import Judge
from pipeline.robots.lerobot_robot import Link
from pipeline.robots.pace import Pace
from pipeline.robots.simulated import ARM
from pipeline.simulation.bodies import load_body
from pipeline.simulation.kinematics import Kinematics
from pipeline.simulation.model import compose
from pipeline.simulation.tasks import PickPlace
from pipeline.simulation.urdf import robot_urdf
from pipeline.simulation.world import LIMITS, OPEN_M, REACH
from schemas.scene import SceneSpec

NAMES = (*(f"{name}.pos" for name in JOINTS), "gripper.pos")
"""Features of a robot built like the arm: joints [rad] and finger opening [m]."""
JOINT_STEP_RAD = 0.15
"""Largest change of a joint target a tick: 3 rad/s at 20 Hz, as the simulated servos follow."""


def is_arm(link: Link) -> bool:
    """Whether a LeRobot robot has the arm's joints, all of them and no other."""
    return set(link.acts) == set(NAMES) and set(NAMES) <= set(link.senses)


class ArmRobot:
    """Implements pipeline.protocols.LiveRobot: end-effector actions, inverse kinematics here, joint targets sent.

    Where its observation has pipeline.frames.ENVIRONMENT, success is judged by what it perceives and it is recorded
    as the arm. Where it has not, a person judges, and joints alone are recorded: nobody made up where the object was.

    Args:
        link: to the robot.
        task: what success means.
        hz: control rate [Hz].
    """

    def __init__(self, link: Link, task: PickPlace, hz: float) -> None:
        self._link, self.name, self.control_hz = link, link.name, hz
        self._sees = set(ENVIRONMENT) <= set(link.senses)
        self.signals = ARM if self._sees else Signals(ARM.state, (), ARM.action)
        self.judge: Literal["sensors", "operator"] = "sensors" if self._sees else "operator"
        self._setup = compose(load_body("arm"), "table")
        self._kinematics = Kinematics(self._setup, 1, 1)
        self._judge, self._pace = Judge(task), Pace(hz)
        self._pose, self._opening, self._joints = np.zeros(4), OPEN_M, np.zeros(6)
        self._before = self._pose, self._joints
        self._begun = False
        self._state, self._seen, self._action = np.zeros(16), np.zeros(len(self.signals.environment)), np.zeros(5)

    def connect(self) -> None:
        """Connect the robot."""
        self._link.connect()

    def disconnect(self) -> None:
        """Let it go."""
        self._link.disconnect()

    def begin(self, scene: SceneSpec) -> None:
        """An attempt begins where the robot stands: what is commanded first is what is measured then."""
        self._begun = False
        self._judge.reset()
        self._pace.restart()

    def observe(self, ids: Ids) -> Observation:
        """The arm's state by its encoders, and the object where the robot perceives it."""
        found = self._link.observe()
        joints = np.array([found[name] for name in NAMES[:6]])
        tool = self.pose_of(joints[None])[0]
        if not self._begun:
            self._begun, self._pose, self._opening, self._joints = True, tool, found[NAMES[6]], joints
        self._state = np.array([*joints, found[NAMES[6]], *tool, *self._pose, self._opening])
        if self._sees:
            self._seen = np.array([found[name] for name in ENVIRONMENT])
        seen = Observation(self._state[None], self._seen[None])
        if self._sees:
            self._judge.see(seen)
        return seen

    def act(self, action: Array, ids: Ids) -> None:
        """Move the commanded pose, send the joints that reach it, and let one control period pass."""
        self._action, self._before = action[0].copy(), (self._pose, self._joints)
        self._pose, self._opening, self._joints = self._solved(action[0], self._pose, self._joints)
        self._link.send(dict(zip(NAMES, map(float, [*self._joints, self._opening]), strict=True)))
        self._pace.wait()

    def _solved(self, action: Array, pose: Array, joints: Array) -> tuple[Array, float, Array]:
        """Pose, opening and joints that an action asks for, from those commanded before."""
        pose = np.clip(pose + np.clip(action[:4], -LIMITS, LIMITS), REACH[:, 0], REACH[:, 1])
        wanted = self._kinematics.towards(joints[None], pose[None])[0]
        return pose, float(np.clip(action[4], 0.0, OPEN_M)), np.clip(wanted, joints - JOINT_STEP_RAD,
                                                                     joints + JOINT_STEP_RAD)

    def would_have_sent(self, action: Array) -> Array:
        """Joint targets [rad] and opening [m] of actions (1, 5) in place of the last one, shape (1, 7)."""
        _, opening, joints = self._solved(action[0], *self._before)
        return np.array([[*joints, opening]])

    def succeeded(self) -> bool:
        """By what the robot perceives; never where it perceives nothing."""
        return self._sees and self._judge.succeeded()

    def phase(self) -> str:
        """Subtask reached, where the robot perceives the object."""
        return self._judge.phase() if self._sees else ""

    def row(self) -> Row | Array:
        """The features of the arm; a real robot has no simulator's state."""
        sent = np.array([*self._joints, self._opening])
        if not self._sees:
            return np.concatenate([self._state[:7], sent])
        return Row(state=self._state, environment=self._seen, action=self._action, joint_action=sent)

    def layout(self) -> TickLayout | None:
        """Recorded as the reference arm, or by its joints alone."""
        return None if self._sees else joint_layout(JOINT_NAMES)

    def pictures(self) -> Mapping[str, NDArray[np.uint8]]:
        """Its cameras, as LeRobot read them."""
        return self._link.pictures

    def attachments(self) -> dict[str, bytes]:
        """The reference arm's URDF."""
        return {"robot.urdf": robot_urdf(self._setup.model, self._setup.body.root, "arm").encode()}

    def pose_of(self, joints: Array) -> Array:
        """Tool pose x, y, z [m], yaw [rad] at joints [rad], shapes (1, 4) and (1, 6)."""
        return self._kinematics.xyz_yaw(joints)

    @property
    def late(self) -> int:
        """Ticks that came late."""
        return self._pace.late
