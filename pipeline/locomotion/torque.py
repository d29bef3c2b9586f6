"""What torque control has without any stiffness: motors that brake, and torques that bear the weight at home."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np


def damp(spec: mujoco.MjSpec, damping: Mapping[str, float], limit: Mapping[str, float]) -> None:
    """Let motors brake: torque = what is asked for - damping * joint speed, all of it within the motor's limit.

    This is a motor driver with a speed gain and no position gain; the arms and legs stay as slack as they were.

    Args:
        spec: the robot; changed in place.
        damping: joint -> speed gain [N m s/rad].
        limit: joint -> largest torque [N m].
    """
    for motor in spec.actuators:
        joint = motor.target
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        motor.biasprm[2] = -damping[joint]
        motor.forcelimited, motor.forcerange = True, [-limit[joint], limit[joint]]


def holding_torques(spec: mujoco.MjSpec, joints: Sequence[str], home: Sequence[float], height_m: float,
                    feet: Sequence[str]) -> tuple[float, ...]:
    """Torques under which the robot at home would stand still, were it ever quite at home [N m].

    Each foot bears an equal share of the weight, straight up, below the centre of mass; then every joint's torque
    follows from statics. All of that a robot knows that knows its own weights and lengths. What stands so stands on
    the tip of a needle: no torque changes with where the joints are.

    Source: virtual work; a foot's force f does what joint torques -J^T f would, J being its point's Jacobian.
    """
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    for joint, angle in zip(joints, home, strict=True):
        data.qpos[model.joint(joint).qposadr[0]] = angle
    data.qpos[2] = height_m
    mujoco.mj_forward(model, data)
    force, jacobian = data.qfrc_bias.copy(), np.zeros((3, model.nv))
    share = np.array([0.0, 0.0, model.body_mass.sum() * -model.opt.gravity[2] / len(feet)])
    for foot in feet:
        body = model.body(foot).id
        below = np.array([data.subtree_com[0, 0], data.xpos[body, 1], 0.0])
        mujoco.mj_jac(model, data, jacobian, None, below, body)
        force -= jacobian.T @ share
    return tuple(float(force[model.joint(joint).dofadr[0]]) for joint in joints)
