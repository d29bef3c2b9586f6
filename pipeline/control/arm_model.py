"""ArmModel: the nominal arm alone, on which plans are tried, and what they cost."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

import mujoco
import numpy as np
from mujoco.batch import Batch

from pipeline.control.arm import ArmSensed
from pipeline.control.broken import broken, forget
from pipeline.control.config import SamplingConfig
from pipeline.protocols import Array
from pipeline.simulation.bodies import Body
from pipeline.simulation.world import OPEN_M

TURN_M = 0.1
"""An angle of 1 rad between the hand and what is asked counts as much as this distance [m]."""
EFFORT_M = 0.02
"""All motors at their limits count as much as this distance [m]."""
SMOOTH_M = 0.003
"""Below about this distance its cost is square, not even: or the last millimetres leave no plan that turns the hand."""
SWING_M = 0.01
"""Joint speeds of 1 rad/s (root mean square) at the end of a plan count as much as this distance [m]."""


class ArmModel:
    """n arms times k plans in one Batch: distance of the hand to what is asked, and effort.

    The nominal arm without payload, delay, play or contacts: what an engineer knows. A plan costs, as a mean over its
    steps, sqrt(|x - x*|^2 + (3 mm)^2) + 0.1 m/rad |turn| + 0.02 m mean((torque / limit)^2), and for its end 0.01 m per
    rad/s.

    Args:
        body: the arm.
        n: how many robots.
        config: k, and the steps of a plan.
        threads: threads of the engine; results do not depend on them.
    """

    def __init__(self, body: Body, n: int, config: SamplingConfig, *, threads: int = 1) -> None:
        spec = body.spec.copy()
        spec.option.timestep = config.step_s
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        model = spec.compile()
        self._n, self._k = n, config.samples
        self._batch = Batch(model, nsim=n * config.samples, nthread=threads)
        joints = [model.joint(j) for j in body.joints]
        self._q, self._v = np.array([j.qposadr[0] for j in joints]), np.array([j.dofadr[0] for j in joints])
        self._fingers = np.array([model.joint(j).qposadr[0] for j in body.fingers])
        self.low: Array = np.array([j.range[0] for j in joints])
        """Joint targets [rad], shape (6,)."""
        self.high: Array = np.array([j.range[1] for j in joints])
        self._limit = model.actuator_forcerange[:6, 1].copy()
        self._site = model.site(body.tool).id
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")

    def costs(self, sensed: ArmSensed, command: Array, actions: Array) -> Array:
        """Costs (n, k) of joint targets (n, k, steps, 6); see pipeline.control.sampling.Model."""
        n, k, steps, _ = actions.shape
        self._batch.reset(stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._qpos[:, self._q] = np.repeat(sensed.joints, k, axis=0)
        self._qvel[:, self._v] = np.repeat(sensed.speeds, k, axis=0)
        self._qpos[:, self._fingers] = OPEN_M / 2
        control = np.full((n * k, steps, 7), OPEN_M / 2)
        control[..., :6] = actions.reshape(n * k, steps, 6)
        forget(self._batch)
        seen = self._batch.rollout(steps, control, record=("site_xpos", "site_xmat", "actuator_force"))
        away, turn = apart(seen["site_xpos"][:, :, self._site], seen["site_xmat"][:, :, self._site],
                           np.repeat(command, k, axis=0)[:, None])
        effort = ((seen["actuator_force"][:, :, :6] / self._limit) ** 2).mean(axis=2)
        swing = np.sqrt((self._qvel[:, self._v] ** 2).mean(axis=1))
        near = np.sqrt(away**2 + SMOOTH_M**2)
        cost = (near + TURN_M * turn + EFFORT_M * effort).mean(axis=1) + SWING_M * swing
        return np.where(broken(self._batch), np.inf, cost).reshape(n, k)


def apart(position: Array, rotation: Array, command: Array) -> tuple[Array, Array]:
    """How far hands are from what is asked: distance [m] and angle [rad].

    Args:
        position: of the hands [m], shape (..., 3).
        rotation: of the hands, row by row, shape (..., 9).
        command: x, y, z [m] and yaw [rad] of a hand that points down, broadcast to (..., 4).
    """
    c, s = np.cos(command[..., 3]), np.sin(command[..., 3])
    # trace(R* R^T) with R* = [[c, s, 0], [s, -c, 0], [0, 0, -1]]
    r = rotation
    trace = c * r[..., 0] + s * r[..., 1] + s * r[..., 3] - c * r[..., 4] - r[..., 8]
    return (np.linalg.norm(position - command[..., :3], axis=-1), np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0)))
