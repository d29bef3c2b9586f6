"""Mapping: from what an input device says to what a robot is asked to do."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from pipeline.errors import RobotError
from pipeline.frames import ACTION, JOINTS, STATE
from pipeline.protocols import Array, Command, Observation, Signals, Teleoperator

SPEED = np.array([0.12, 0.12, 0.12, 0.9])
"""Full speed of a person's hand on the arm's tool [m/s, m/s, m/s, rad/s]; less than half of what the arm can do."""
GRIP_M_S = 0.16
"""Full speed of the gripper [m/s]: open to closed in half a second."""
OPEN_M = 0.08
"""Largest finger opening of the arm [m]."""
DELTAS = ("delta_x", "delta_y", "delta_z", "delta_yaw")
"""Names under which LeRobot's gamepad and keyboard give shares of full speed."""
RATES = (".vel", "_velocity")
"""Ends of names of values that are speeds: zero stands still."""

_CMD = slice(STATE.index("cmd_x"), STATE.index("cmd_yaw") + 1)
_CMD_GRIPPER = STATE.index("cmd_gripper")


class Driver(Protocol):
    """Turns commands into actions of one robot."""

    def action(self, command: Command, observation: Observation) -> Array:
        """The action that a command asks for, shape (k,); not yet checked against any limit."""
        ...

    def hold(self, observation: Observation) -> Array:
        """The action that keeps the robot where it is, shape (k,)."""
        ...

    def sent(self, action: Array) -> None:
        """Take note of what was really sent, shape (k,)."""
        ...


class ArmDriver:
    """The arm: axes move the tool; joint targets move it to the pose that they mean, tool down.

    Args:
        hz: control rate [Hz].
        pose_of: x, y, z [m] and yaw [rad] of the tool, shape (1, 4), at joints [rad], shape (1, 6).
        speed: factor on the full speed of axes.
    """

    def __init__(self, hz: float, pose_of: Callable[[Array], Array], *, speed: float = 1.0) -> None:
        self._step, self._grip, self._pose_of = SPEED * speed / hz, GRIP_M_S / hz, pose_of

    def action(self, command: Command, observation: Observation) -> Array:
        """See Driver; columns are pipeline.frames.ACTION."""
        state = observation.state[0]
        opening = state[_CMD_GRIPPER]
        if command.targets:
            joints = np.array([[command.targets[name] for name in JOINTS]])
            if not np.isfinite(joints).all():
                return np.array([*joints[0, :4], command.targets["gripper"]])  # the guard says which one
            step = self._pose_of(joints)[0] - state[_CMD]
            step[3] = (step[3] + np.pi) % (2 * np.pi) - np.pi
            return np.array([*step, command.targets["gripper"]])
        axes = np.array((*command.axes, 0.0, 0.0, 0.0, 0.0)[:4])
        return np.array([*(axes * self._step), np.clip(opening + command.grip * self._grip, 0.0, OPEN_M)])

    def hold(self, observation: Observation) -> Array:
        """See Driver."""
        return np.array([0.0, 0.0, 0.0, 0.0, observation.state[0, _CMD_GRIPPER]])

    def sent(self, action: Array) -> None:
        """Nothing to note: the arm's state says what was commanded."""


class JointDriver:
    """Any other robot: targets go through by name; axes jog the joints one by one, in the robot's order.

    Args:
        signals: the robot's columns; every position that it is commanded, it also measures.
        jog: how far full speed moves each action column a tick, or for speeds their full value, shape (k,).
    """

    def __init__(self, signals: Signals, jog: Array) -> None:
        self._names, self._jog = signals.action, jog
        self._rate = np.array([name.endswith(RATES) for name in signals.action])
        self._grips = np.array(["gripper" in name for name in signals.action])
        self._measured = [signals.state.index(n) if n in signals.state else -1 for n in signals.action]
        self._targets: Array | None = None

    def action(self, command: Command, observation: Observation) -> Array:
        """See Driver; targets keep running from the last one sent, so that a jogged joint does not sag."""
        if command.targets:
            return np.array([command.targets[plain(name)] for name in self._names])
        last = self.hold(observation)
        shares = np.zeros(len(self._names))
        free = np.flatnonzero(~self._grips)[:len(command.axes)]
        shares[free] = command.axes[:len(free)]
        shares[self._grips] = command.grip
        return last + shares * self._jog

    def sent(self, action: Array) -> None:
        """See Driver: jogging goes on from there."""
        self._targets = np.where(self._rate, 0.0, action)

    def hold(self, observation: Observation) -> Array:
        """See Driver."""
        if self._targets is None:
            self._targets = np.where(self._rate, 0.0, np.append(observation.state[0], 0.0)[self._measured])
        return np.where(self._rate, 0.0, self._targets)


def plain(name: str) -> str:
    """A joint's name without lerobot's `.pos`."""
    return name.removesuffix(".pos")


def check_fit(device: Teleoperator, signals: Signals, robot: str) -> None:
    """Refuse a device whose joint targets are not the robot's, before anything moves.

    Raises:
        RobotError: names what is missing and what is too much.
    """
    wanted = (*JOINTS, "gripper") if signals.action == ACTION else tuple(plain(name) for name in signals.action)
    if device.joints and set(device.joints) != set(wanted):
        missing, extra = _not_in(wanted, device.joints), _not_in(device.joints, wanted)
        told = "; ".join(text for text in (f"missing: {missing}" if missing else "",
                                           f"not of the robot: {extra}" if extra else "") if text)
        raise RobotError(f"teleoperator {device.name!r} does not fit robot {robot!r}: {told}",
                         where=f"action of {device.name}",
                         mend=f"use a leader of the same joints ({', '.join(wanted)}), a keyboard or a gamepad")


def _not_in(names: Sequence[str], others: Sequence[str]) -> str:
    return ", ".join(name for name in names if name not in others)
