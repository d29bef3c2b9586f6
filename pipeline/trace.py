"""Trace: all that one attempt leaves behind, tick by tick; what a recording holds."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import Frames

type Rows = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Event:
    """A trigger, an intervention or a limit that was hit."""

    tick: int
    level: int
    """rcl_interfaces/msg/Log levels: 20 info, 30 warn, 40 error."""
    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Shadow:
    """What a policy that may not act would have done."""

    joint_commands: Rows
    """Joint targets the shadow asked for [rad, m], shape (m, 7)."""
    disagreement: Rows
    """Distance of its action to the champion's, in scales of the action, shape (m,)."""


@dataclass(frozen=True, slots=True)
class Trace:
    """One attempt; m ticks at `hz`. Every array is float64, rows are ticks."""

    hz: float
    state: Rows
    """See pipeline.frames.STATE, shape (m, 16)."""
    environment: Rows
    """See pipeline.frames.ENVIRONMENT, shape (m, 7)."""
    action: Rows
    """See pipeline.frames.ACTION, shape (m, 5)."""
    joint_action: Rows
    """Joint targets sent [rad] and opening [m], shape (m, 7)."""
    joint_velocity: Rows
    """Measured [rad/s] and opening speed [m/s], shape (m, 7)."""
    joint_effort: Rows
    """Actuator torque [N m] and grip force [N], shape (m, 7)."""
    links: tuple[str, ...]
    """Bodies on /tf, named as the URDF's links; the cube is 'object'."""
    link_poses: Rows
    """World poses x, y, z [m], qw, qx, qy, qz, true in simulation, for the 3D view only, shape (m, len(links), 7)."""
    phase: tuple[str, ...]
    """Subtask at each tick."""
    reward: Mapping[str, Rows]
    """Reward term -> value at each tick, shape (m,)."""
    sim_state: Rows
    """mjSTATE_INTEGRATION before the action of the tick, shape (m, nstate)."""
    controller: Rows
    """The rest of what a restore needs (command, delay line, backlash, hold counter, policy memory), shape (m, k)."""
    shadows: Mapping[str, Shadow] = field(default_factory=dict[str, Shadow])
    events: tuple[Event, ...] = ()
    signals: Mapping[str, Rows] = field(default_factory=dict[str, Rows])
    """What was computed of the attempt's risk, see pipeline.signals -> value at each tick, NaN where unknown, (m,)."""
    joints: tuple[str, ...] = ()
    """Joints of a legged robot, j of them; empty for the reference arm. Where there are any, state is what
    pipeline.locomotion.world.LeggedWorld.observe tells, environment holds nothing, action are shares, and everything
    about joints has j columns."""
    torque: bool = False
    """Whether joint_action are torques [N m] rather than angles [rad]."""
    joint_position: Rows = field(default_factory=lambda: np.zeros((0, 0)))
    """Angles that a legged robot measured [rad], shape (m, j)."""
    imu: Rows = field(default_factory=lambda: np.zeros((0, 7)))
    """Orientation qw, qx, qy, qz as a legged robot's IMU tells it, without a heading, and turning speed [rad/s],
    shape (m, 7)."""

    def __len__(self) -> int:
        return len(self.state)

    def frames(self) -> Frames:
        """The dataset's features of the reference arm; nothing that a robot cannot sense is in them."""
        f32 = np.float32
        return Frames(self.state.astype(f32), self.environment.astype(f32),
                      self.action.astype(f32), self.joint_action.astype(f32))
