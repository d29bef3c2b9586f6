"""ArmPlant: n reference arms in one engine that take joint targets, each with physics and a goal of its own."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mujoco.batch import Batch

from pipeline.control.parts import Memory
from pipeline.control.reaches import Reach
from pipeline.protocols import Array
from pipeline.simulation.bodies import load_body
from pipeline.simulation.kinematics import Kinematics
from pipeline.simulation.model import compose
from pipeline.simulation.physics import Applied, from_draws
from pipeline.simulation.world import CONTROL_HZ, OPEN_M

CUBE_M = (-0.6, 0.0, 0.02)
"""Where the scene's cube lies: out of reach, for nothing is to be grasped."""


@dataclass(frozen=True, slots=True)
class ArmSensed:
    """What n arms feel: encoders, and what their nominal kinematics make of them."""

    joints: Array
    """[rad], shape (n, 6)."""
    speeds: Array
    """[rad/s], shape (n, 6)."""
    tool: Array
    """x, y, z [m] and yaw [rad] of the hand, shape (n, 4)."""


class ArmPlant:
    """n arms at their posture of rest, moved by joint targets; the fingers stay open.

    Between a target and its servo lie the delay and the play of each one's physics, as in the training simulation; here
    the delay runs on the engine's clock, so that it is the same time whatever the rates.

    Args:
        reaches: goal, physics and payload of each.
        threads: threads of the engine; results do not depend on them.
    """

    def __init__(self, reaches: Sequence[Reach], *, threads: int = 1) -> None:
        setup = compose(load_body("arm"), "table")
        model, body, n = setup.model, setup.body, len(reaches)
        self.setup, self.n, self.threads = setup, n, threads
        self.clock_hz = float(1 / model.opt.timestep)
        self.goals: Array = np.array([r.goal for r in reaches], np.float64).reshape(n, 4)
        """x, y, z [m] and yaw [rad] where each hand is to be, shape (n, 4)."""
        self.kinematics = Kinematics(setup, n, threads)
        self.home: Array = np.array(body.home)
        self._batch = Batch(model, nsim=n, nthread=threads)
        self._q = np.array([model.joint(j).qposadr[0] for j in body.joints])
        self._v = np.array([model.joint(j).dofadr[0] for j in body.joints])
        self.limit: Array = model.actuator_forcerange[:6, 1].copy()
        """Largest torque of each joint [N m], shape (6,)."""
        self._qpos, self._qvel, self._ctrl = (self._batch.bind(k) for k in ("qpos", "qvel", "ctrl"))
        self._torque = self._batch.bind("actuator_force")
        self._physics = physics = from_draws([r.draws for r in reaches])
        Applied(self._batch, model, self._v).write(np.arange(n), physics, np.full(n, CUBE_M[2]))
        self._load(np.array([r.payload_kg for r in reaches]))
        self._delay = np.round(physics.delay * self.clock_hz / CONTROL_HZ).astype(int)
        self._qpos[:, self._q] = self.home
        fingers = [model.joint(j).qposadr[0] for j in body.fingers]
        self._qpos[:, fingers] = OPEN_M / 2
        cube = int(model.joint("object").qposadr[0])
        self._qpos[:, cube:cube + 3] = CUBE_M
        self._ctrl[:] = [*self.home, OPEN_M / 2]
        self._line = np.repeat(self._ctrl[:, None, :6], int(self._delay.max()) + 1, axis=1)
        self.effort: Array = np.zeros(n)
        """Mean squared share of the joints' largest torques, over the steps of the last action, shape (n,)."""

    def rest(self) -> Array:
        """The action that keeps the posture of rest, shape (n, 6)."""
        return np.repeat(self.home[None], self.n, axis=0)

    def _load(self, payload_kg: Array) -> None:
        """Give each hand more mass, whose weight nobody compensates."""
        at = self.setup.model.body("gripper").id
        mass, lift = self._batch.expand("body_mass"), self._batch.expand("body_gravcomp")
        lift[:, at] *= mass[:, at] / (mass[:, at] + payload_kg)
        mass[:, at] += payload_kg
        self._batch.set_const()

    def sense(self) -> ArmSensed:
        """Encoders and forward kinematics."""
        q = self._qpos[:, self._q]
        return ArmSensed(q, self._qvel[:, self._v], self.kinematics.xyz_yaw(q))

    def hand(self) -> tuple[Array, Array]:
        """Where the hands are [m], shape (n, 3), and how they are turned, row by row, shape (n, 9)."""
        position, rotation = self.kinematics.pose(self._qpos[:, self._q])
        return position, rotation.reshape(self.n, 9)

    def act(self, action: Array, steps: int) -> None:
        """Send joint targets [rad], shape (n, 6), held for some steps of the engine."""
        line, rows, half = self._line, np.arange(self.n), self._physics.backlash[:, None] / 2
        used = np.zeros(self.n)
        for _ in range(steps):
            line[:, 1:] = line[:, :-1]
            line[:, 0] = action
            wanted, motor = line[rows, self._delay], self._ctrl[:, :6]
            # Play operator: the joint follows only once the motor has crossed the gap.
            motor[:] = np.clip(motor, wanted - half, wanted + half)
            self._batch.step()
            used += ((self._torque[:, :6] / self.limit) ** 2).mean(axis=1)
        self.effort = used / steps

    def save(self) -> Memory:
        """The engine's state and the commands under way."""
        return {"state": self._batch.state.copy(), "line": self._line.copy(), "effort": self.effort.copy()}

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        self._batch.state[:], self._line[:], self.effort = memory["state"], memory["line"], memory["effort"].copy()
