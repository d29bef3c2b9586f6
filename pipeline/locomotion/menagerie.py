"""Humanoids of MuJoCo Menagerie and robots of files, as LeggedBody; the models are used where they lie."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from pipeline.errors import SimulationError, one_line
from pipeline.locomotion.body import Control, LeggedBody, add_touch
from pipeline.locomotion.torque import damp, holding_torques
from pipeline.protocols import Array

H1_HOME: Mapping[str, float] = {"hip_pitch": -0.4, "knee": 0.8, "ankle": -0.4, "elbow": 0.5}
"""Joint name ends -> angle [rad]: knees bent, feet flat, forearms forward."""
H1_DAMPING: Mapping[str, float] = {"knee": 4.0, "torso": 6.0}
"""Joint name ends -> speed gain of its motor [N m s/rad]; 2 for others: those that H1 is commonly run with."""
TORQUE_SHARE = 0.6
"""Share of a motor's limit that an action of 1 asks for."""
FLAT_M = 0.02
"""How far above the lowest point of a robot its feet may end [m]."""
SERVO_RAD = 0.5
"""What an action of 1 moves a servo's target by [rad]."""


def unitree_h1() -> LeggedBody:
    """Unitree H1: 19 motors under torque control, with speed gains and the torques of its weight, but no stiffness."""
    spec = mujoco.MjSpec.from_file(str(_file("unitree_h1", "h1.xml")))
    joints = tuple(a.target for a in spec.actuators)
    home = tuple(_by_end(H1_HOME, joint, 0.0) for joint in joints)
    damp(spec, {joint: _by_end(H1_DAMPING, joint, 2.0) for joint in joints},
         {a.target: float(a.ctrlrange[1]) for a in spec.actuators})
    body = _legged(spec, "pelvis", joints, home, ("left_ankle_link", "right_ankle_link"), "torque", TORQUE_SHARE)
    return replace(body, rest=holding_torques(body.spec, joints, home, body.height_m, body.feet))


def _by_end(table: Mapping[str, float], joint: str, otherwise: float) -> float:
    return next((value for end, value in table.items() if joint.endswith(end)), otherwise)


def unitree_g1() -> LeggedBody:
    """Unitree G1: 29 position servos."""
    spec = mujoco.MjSpec.from_file(str(_file("unitree_g1", "g1.xml")))
    joints = tuple(a.target for a in spec.actuators)
    home = tuple(float(v) for v in list(spec.key("stand").qpos)[7:])
    return _legged(spec, "pelvis", joints, home, ("left_ankle_roll_link", "right_ankle_roll_link"), "position",
                   SERVO_RAD)


def legged_from_file(path: Path) -> LeggedBody:
    """Any floating robot from an MJCF or URDF file; home is its first keyframe, else all joints at 0.

    Its actuators decide how it is commanded: position servos, else torques. Its feet are the bodies that lie lowest.
    URDF knows neither floating bases nor actuators: its root floats, and each joint with an effort gets a motor.

    Raises:
        SimulationError: the file does not load, nothing floats, or nothing is driven.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        if path.suffix == ".urdf":
            _float_and_drive(spec)
        model = spec.copy().compile()
    except (ValueError, OSError) as error:
        raise SimulationError(f"model does not load: {one_line(error)}", where=path,
                              mend="give an MJCF or URDF file whose meshes lie where it says") from error
    free = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1 or not model.nu:
        raise SimulationError(f"{len(free)} floating bodies and {model.nu} actuators", where=path,
                              mend="give one body a free joint, and each hinge that moves an actuator (in a URDF: "
                                   "an effort in its limit)")
    joints = tuple(model.joint(int(j)).name for j in model.actuator_trnid[:, 0])
    start = model.key_qpos[0] if model.nkey else model.qpos0
    home = tuple(float(start[model.joint(j).qposadr[0]]) for j in joints)
    servo = bool((model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE).all())
    return _legged(spec, model.body(int(model.jnt_bodyid[free[0]])).name, joints, home, _lowest(model, start),
                   "position" if servo else "torque", SERVO_RAD if servo else TORQUE_SHARE)


def _float_and_drive(spec: mujoco.MjSpec) -> None:
    """Make a URDF's robot one that stands free and moves: a free joint at its root, motors as strong as `effort`."""
    root = spec.worldbody.first_body()
    if root is not None and not list(root.joints):
        root.add_freejoint()
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and joint.actfrcrange[1] > 0:
            motor = spec.add_actuator(name=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint.name)
            motor.set_to_motor()
            motor.forcelimited, motor.forcerange = True, joint.actfrcrange


def _file(robot: str, name: str) -> Path:
    """Where Menagerie keeps a file: under MENAGERIE_ROOT, or in its cache, downloaded the first time."""
    import mujoco_menagerie

    try:
        path = Path(mujoco_menagerie.get(robot).path()) / name
    except (mujoco_menagerie.MenagerieError, OSError) as error:
        raise SimulationError(f"{robot} is not at hand: {one_line(error)}", where="MuJoCo Menagerie",
                              mend="connect to the network once, or set MENAGERIE_ROOT to a folder that holds "
                                   f"{robot}/{name}") from error
    if not path.exists():
        raise SimulationError(f"{robot} lacks {name}", where=path.parent, mend="set MENAGERIE_ROOT to a whole copy")
    return path


def _legged(spec: mujoco.MjSpec, root: str, joints: tuple[str, ...], home: tuple[float, ...], feet: tuple[str, ...],
            control: Control, scale: float) -> LeggedBody:
    for key in list(spec.keys):
        spec.delete(key)
    for light in list(spec.lights):
        spec.delete(light)  # the scene has its own
    for geom in spec.geoms:  # only feet touch, and only the ground: a fall ends the attempt before anything else would
        touches = geom.parent.name in feet and geom.contype != 0
        geom.contype, geom.conaffinity = (1, 2) if touches else (0, 0)
    add_touch(spec, feet)
    return LeggedBody(spec, root, joints, home, _standing(spec, joints, home), feet, control, scale)


def _standing(spec: mujoco.MjSpec, joints: tuple[str, ...], home: tuple[float, ...]) -> float:
    """Height of the base at which the lowest touching geom just meets the ground [m]."""
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    for joint, angle in zip(joints, home, strict=True):
        data.qpos[model.joint(joint).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    touching = np.flatnonzero(model.geom_contype == 1)
    lowest = min(_bottom(model, data, int(g)) for g in touching)
    return float(data.qpos[2] - lowest)


def _bottom(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Lowest point of a geom [m]: exact for spheres, capsules and boxes; a bound by its box for others."""
    turn = data.geom_xmat[geom].reshape(3, 3)[2]
    size, kind = model.geom_size[geom], model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        reach = size[0]
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        reach = size[0] + abs(turn[2]) * size[1]
    else:
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        return float(data.geom_xpos[geom, 2] + turn @ centre - np.abs(turn) @ half)
    return float(data.geom_xpos[geom, 2] - reach)


def _lowest(model: mujoco.MjModel, qpos: Array) -> tuple[str, ...]:
    """The bodies that lie within 2 cm of the lowest point of the robot in a posture."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    bottom = {g: _bottom(model, data, g) for g in range(model.ngeom)
              if model.geom_contype[g] and model.geom_bodyid[g]}  # a floor of the file's own is no part of the robot
    floor = min(bottom.values(), default=0.0)
    lowest = [int(model.geom_bodyid[g]) for g, z in bottom.items() if z < floor + FLAT_M]
    return tuple(dict.fromkeys(model.body(b).name for b in lowest))
