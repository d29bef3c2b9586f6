"""Robot bodies: the reference arm from primitives, and any body given as an MJCF or URDF file."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import mujoco
from pydantic import Field

from pipeline.errors import SimulationError, one_line, unknown
from schemas.base import Frozen


class JointConfig(Frozen):
    """One hinge and its position servo."""

    name: str
    axis: tuple[float, float, float]
    range_rad: tuple[float, float]
    kp: float = Field(gt=0, description="servo stiffness [N m/rad]")
    kv: float = Field(ge=0, description="servo damping [N m s/rad]")
    damping: float = Field(ge=0, description="[N m s/rad]")
    armature: float = Field(ge=0, description="reflected rotor inertia [kg m^2]")
    frictionloss: float = Field(ge=0, description="dry friction [N m]")
    torque_limit: float = Field(gt=0, description="[N m]")
    home_rad: float


def _large(name: str, axis: tuple[float, float, float], low: float, high: float, home: float) -> JointConfig:
    return JointConfig(name=name, axis=axis, range_rad=(low, high), kp=250, kv=6, damping=6, armature=0.10,
                       frictionloss=0.3, torque_limit=30, home_rad=home)


def _wrist(name: str, axis: tuple[float, float, float], low: float, high: float, home: float) -> JointConfig:
    return JointConfig(name=name, axis=axis, range_rad=(low, high), kp=50, kv=1.2, damping=1.2, armature=0.02,
                       frictionloss=0.05, torque_limit=8, home_rad=home)


class ArmConfig(Frozen):
    """A 6-DoF tabletop arm with a parallel gripper; lengths [m], masses [kg]."""

    shoulder_height: float = 0.16
    upper_arm: float = 0.28
    forearm: float = 0.26
    tool: float = Field(default=0.13, description="wrist axis to the point between the pads")
    link_mass: tuple[float, float, float, float] = (1.2, 0.9, 0.5, 0.3)
    joints: tuple[JointConfig, ...] = (
        _large("joint1", (0, 0, 1), -2.4, 2.4, 0.0),
        _large("joint2", (0, 1, 0), -1.6, 1.9, -0.35),
        _large("joint3", (0, 1, 0), -0.3, 2.9, 2.05),
        _wrist("joint4", (0, 0, 1), -2.2, 2.2, 0.0),
        _wrist("joint5", (0, 1, 0), -2.2, 2.4, 1.44),
        _wrist("joint6", (0, 0, 1), -3.1, 3.1, 0.0),
    )
    finger_travel: float = Field(default=0.04, description="of each finger, half the largest opening")
    finger_kp: float = Field(default=600, description="[N/m]")
    finger_kv: float = 10
    finger_force: float = Field(default=25, description="[N]")
    pad_half: tuple[float, float, float] = (0.012, 0.004, 0.014)
    pad_friction: float = 1.0


ARM = ArmConfig()


class Flex(Frozen):
    """A passive hinge in the forearm: structure that the training simulation lacks."""

    stiffness: float = Field(gt=0, description="[N m/rad]")
    damping: float = Field(ge=0, description="[N m s/rad]")


@dataclass(frozen=True, slots=True)
class Body:
    """A robot as a spec that a scene is built around, and the names that its controller needs."""

    spec: mujoco.MjSpec
    root: str
    """The body that stands at the scene's origin."""
    tool: str | None
    """Site between the fingers; None for a body without a known tool."""
    joints: tuple[str, ...]
    """Actuated hinges, base to tool."""
    fingers: tuple[str, ...]
    home: tuple[float, ...]
    """Joint positions at reset [rad]."""


def _link(parent: mujoco.MjsBody, name: str, pos: tuple[float, float, float], joint: JointConfig | None,
          end: tuple[float, float, float], radius: float, mass: float, colour: tuple[float, ...]) -> mujoco.MjsBody:
    body = parent.add_body(name=name, pos=pos, gravcomp=1.0)
    if joint is not None:
        body.add_joint(name=joint.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis, range=joint.range_rad,
                       limited=True, damping=joint.damping, armature=joint.armature,
                       frictionloss=joint.frictionloss)
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, *end], size=[radius, 0, 0],
                  mass=mass, contype=0, conaffinity=0, rgba=colour)
    return body


def _gripper(hand: mujoco.MjsBody, config: ArmConfig, spec: mujoco.MjSpec) -> None:
    dark = (0.16, 0.17, 0.20, 1.0)
    # Half a turn about the tool axis, so that the tool's x points forward when it points down.
    palm = hand.add_body(name="gripper", quat=[0, 0, 0, 1], gravcomp=1.0)
    palm.add_geom(name="palm", type=mujoco.mjtGeom.mjGEOM_BOX, pos=[0, 0, config.tool - 0.055],
                  size=[0.016, 0.05, 0.012], mass=0.12, contype=0, conaffinity=0, rgba=dark)
    palm.add_site(name="tool", pos=[0, 0, config.tool], size=[0.004, 0, 0], rgba=[0, 0, 0, 0])
    half = config.pad_half
    for side, sign in (("left", 1.0), ("right", -1.0)):
        finger = palm.add_body(name=f"{side}_finger", pos=[0, sign * half[1], config.tool], gravcomp=1.0)
        finger.add_joint(name=f"{side}_slide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, sign, 0],
                         range=[0, config.finger_travel], limited=True, damping=4, armature=0.05)
        finger.add_geom(name=f"{side}_rod", type=mujoco.mjtGeom.mjGEOM_BOX, pos=[0, 0, -0.03],
                        size=[0.008, half[1], 0.018], mass=0.01, contype=0, conaffinity=0, rgba=dark)
        finger.add_geom(name=f"{side}_pad", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, mass=0.02, contype=1,
                        conaffinity=2, condim=4, friction=[config.pad_friction, 0.01, 0.0001],
                        rgba=(0.93, 0.55, 0.18, 1.0))
    spec.add_equality(name="fingers", type=mujoco.mjtEq.mjEQ_JOINT, name1="right_slide", name2="left_slide",
                      objtype=mujoco.mjtObj.mjOBJ_JOINT, data=[0, 1, *[0] * 10])


def arm(config: ArmConfig = ARM, flex: Flex | None = None) -> Body:
    """The reference arm; with `flex` a passive spring hinge splits the forearm."""
    spec = mujoco.MjSpec()
    spec.modelname = "hardcase-arm"
    spec.compiler.degree = False
    white, blue = (0.90, 0.91, 0.93, 1.0), (0.20, 0.42, 0.74, 1.0)
    j, mass = config.joints, config.link_mass
    base = spec.worldbody.add_body(name="base_link")
    base.add_geom(name="base", type=mujoco.mjtGeom.mjGEOM_CYLINDER, pos=[0, 0, 0.03], size=[0.07, 0.03, 0],
                  contype=0, conaffinity=0, rgba=(0.16, 0.17, 0.20, 1.0), mass=2)
    turret = _link(base, "turret", (0, 0, 0.06), j[0], (0, 0, config.shoulder_height - 0.06), 0.045, 1.0, white)
    upper = _link(turret, "upper_arm", (0, 0, config.shoulder_height - 0.06), j[1], (0, 0, config.upper_arm), 0.034,
                  mass[0], blue)
    fore = _link(upper, "forearm", (0, 0, config.upper_arm), j[2], (0, 0, config.forearm / 2), 0.028, mass[1] / 2,
                 white)
    if flex is not None:
        fore = fore.add_body(name="forearm_flex", pos=[0, 0, config.forearm / 2], gravcomp=1.0)
        fore.add_joint(name="flex", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0], stiffness=flex.stiffness,
                       damping=flex.damping, armature=0.005)
        fore.add_geom(name="forearm_flex", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.028, 0, 0], mass=0.05,
                      contype=0, conaffinity=0, rgba=white)
        offset = (0.0, 0.0, 0.0)
    else:
        offset = (0.0, 0.0, config.forearm / 2)
    roll = _link(fore, "forearm_roll", offset, j[3], (0, 0, config.forearm / 2), 0.026, mass[1] / 2, white)
    wrist = _link(roll, "wrist", (0, 0, config.forearm / 2), j[4], (0, 0, 0.03), 0.024, mass[2], blue)
    hand = _link(wrist, "hand", (0, 0, 0.0), j[5], (0, 0, 0.06), 0.022, mass[3], white)
    _gripper(hand, config, spec)
    for joint in j:
        actuator = spec.add_actuator(name=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint.name)
        actuator.set_to_position(kp=joint.kp, kv=joint.kv)
        actuator.forcelimited, actuator.forcerange = True, [-joint.torque_limit, joint.torque_limit]
    grip = spec.add_actuator(name="gripper", trntype=mujoco.mjtTrn.mjTRN_JOINT, target="left_slide")
    grip.set_to_position(kp=config.finger_kp, kv=config.finger_kv)
    grip.forcelimited, grip.forcerange = True, [-config.finger_force, config.finger_force]
    return Body(spec, "base_link", "tool", tuple(x.name for x in j), ("left_slide", "right_slide"),
                tuple(x.home_rad for x in j))


def from_file(path: Path) -> Body:
    """Any robot from an MJCF or URDF file: its first body is the root, its hinges and slides are its joints.

    Raises:
        SimulationError: the file does not load, or holds no body.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.copy().compile()
    except (ValueError, OSError) as error:
        raise SimulationError(f"model does not load: {one_line(error)}", where=path,
                              mend="give an MJCF or URDF file whose meshes lie where it says") from error
    if not spec.worldbody.bodies:
        raise SimulationError("model holds no body", where=path, mend="give a file with at least one body")
    for key in list(spec.keys):
        spec.delete(key)  # a keyframe holds the positions of the robot alone: it would not fit a scene
    moving = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    joints = tuple(x.name for x in spec.joints if x.type in moving)
    return Body(spec, spec.worldbody.bodies[0].name, None, joints, (), (0.0,) * len(joints))


ROBOTS: MappingProxyType[str, Callable[[], Body]] = MappingProxyType({"arm": arm})
"""Robot name -> how to build it. Add one: a function that returns a Body, and an entry here."""


def load_body(robot: str) -> Body:
    """The body of that name, or the one in that MJCF or URDF file."""
    if robot in ROBOTS:
        return ROBOTS[robot]()
    if robot.endswith((".xml", ".urdf", ".mjcf")):
        return from_file(Path(robot))
    raise unknown("robot", robot, [*ROBOTS, "PATH.xml", "PATH.urdf"])
