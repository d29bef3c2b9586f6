"""Kinematics of many robots at once: tool pose, and one damped least-squares step towards a pose."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

import mujoco
import numpy as np
from mujoco.batch import Batch

from pipeline.errors import SimulationError
from pipeline.protocols import Array
from pipeline.simulation.model import Setup

LAMBDA = 0.03
"""Damping of the least squares [m or rad per rad]; Nakamura and Hanafusa 1986, singularity robust inverse."""


class Kinematics:
    """The nominal robot alone, n times, as its controller knows it.

    Args:
        setup: compiled robot.
        n: how many robots.
        threads: threads of the engine.

    Raises:
        SimulationError: the body names no tool, so that nobody knows what to move where.
    """

    def __init__(self, setup: Setup, n: int, threads: int) -> None:
        model = setup.robot_model
        if setup.body.tool is None:
            raise SimulationError("robot has no tool to move", where=f"body {setup.body.root}",
                                  mend="build it with a Body that names its tool site, as arm() does, or use robot arm")
        self._batch = Batch(model, nsim=n, nthread=threads)
        self._site = model.site(setup.body.tool).id
        self._body = int(model.site_bodyid[self._site])
        self._adr = np.array([model.jnt_qposadr[model.joint(name).id] for name in setup.body.joints])
        self._dof = np.array([model.jnt_dofadr[model.joint(name).id] for name in setup.body.joints])
        self._range = np.array([model.joint(name).range for name in setup.body.joints])
        self._qpos = self._batch.bind("qpos")
        self._pos, self._mat = self._batch.bind("site_xpos"), self._batch.bind("site_xmat")

    def pose(self, q: Array) -> tuple[Array, Array]:
        """Tool position [m], shape (k, 3), and rotation, shape (k, 3, 3), at joints q [rad], shape (k, nq)."""
        ids = np.arange(len(q))
        self._qpos[: len(q), self._adr] = q
        self._batch.forward(ids, stage=int(mujoco.mjtStage.mjSTAGE_POS))
        return self._pos[: len(q), self._site].copy(), self._mat[: len(q), self._site].reshape(-1, 3, 3).copy()

    def xyz_yaw(self, q: Array) -> Array:
        """Tool position [m] and yaw of the tool's x axis [rad], shape (k, 4)."""
        position, rotation = self.pose(q)
        return np.column_stack([position, np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])])

    def towards(self, q: Array, target: Array) -> Array:
        """One damped least-squares step from q to a tool that points down.

        dq = J^T (J J^T + lambda^2 I)^-1 e, with e the position error and half the sum of the cross products
        of the axes as the rotation error (Siciliano et al., Robotics, section 3.7.3).

        Args:
            q: joints [rad], shape (k, nq).
            target: x, y, z [m] and yaw [rad], shape (k, 4).

        Returns:
            Joints within their limits [rad], shape (k, nq).
        """
        ids = np.arange(len(q))
        position, rotation = self.pose(q)
        jacp, jacr = self._batch.jac(self._body, position, ids)
        jacobian = np.concatenate([jacp[:, :, self._dof], jacr[:, :, self._dof]], axis=1)
        turn = 0.5 * np.cross(rotation, _down(target[:, 3]), axis=1).sum(axis=2)
        error = np.concatenate([target[:, :3] - position, turn], axis=1)
        square = jacobian @ jacobian.transpose(0, 2, 1)
        square[:, np.arange(6), np.arange(6)] += LAMBDA**2
        step = (jacobian.transpose(0, 2, 1) @ np.linalg.solve(square, error[:, :, None]))[:, :, 0]
        return np.clip(q + step, self._range[:, 0], self._range[:, 1])


def _down(yaw: Array) -> Array:
    """Rotations of a tool that points down with its x axis at `yaw`, shape (k, 3, 3)."""
    rotation = np.zeros((len(yaw), 3, 3))
    c, s = np.cos(yaw), np.sin(yaw)
    rotation[:, 0, 0], rotation[:, 1, 0] = c, s
    rotation[:, 0, 1], rotation[:, 1, 1] = s, -c
    rotation[:, 2, 2] = -1.0
    return rotation
