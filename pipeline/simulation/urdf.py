"""URDF of a robot from its compiled model, so that viewers that know no MJCF show and move it."""
# MuJoCo's bindings carry no types.
# pyright: reportMissingTypeStubs=false, reportUnknownParameterType=false, reportUnknownMemberType=false
# pyright: reportAttributeAccessIssue=false, reportUnknownArgumentType=false, reportUnknownVariableType=false

from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SimulationError, unknown

UNLIMITED = 1e6
"""What an unstated effort or velocity limit is written as; URDF asks for both [N, N m, m/s, rad/s]."""
_VIRTUAL_MASS_KG = 1e-9
"""Mass of a link that only joins two joints of one body; physics engines refuse 0."""
_VISIBLE_GROUPS = 3
"""Geom groups 0-2 are drawn, as in MuJoCo's own viewer."""

type Vector = NDArray[np.float64]


def robot_urdf(model: mujoco.MjModel, root: str, name: str) -> str:
    """URDF of the tree below body `root`: one link a body, of the same name and in the same frame.

    Joint values mean what they mean in MuJoCo (`qpos`, `ref` included). A joint that is not at its body's
    origin, or one of several of a body, gets a link of its own before the body's. Boxes, cylinders, spheres and
    capsules (as a cylinder with two spheres) of the drawn groups become visuals; other shapes are left out.

    Args:
        model: compiled model.
        root: body that becomes the root link; how it stands in the world, and its own joints, are not the URDF's.
        name: the robot's name.

    Raises:
        ConfigError: there is no body of that name.
        SimulationError: a ball or free joint below the root, which URDF cannot say.

    Source: MuJoCo documentation, "Computation / Kinematics"; ROS URDF specification (wiki.ros.org/urdf/XML).
    """
    names = {_body(model, b): b for b in range(model.nbody)}
    if root not in names:
        raise unknown("body", root, names)
    robot = ET.Element("robot", name=name)
    below = {names[root]}
    for body in range(names[root], model.nbody):
        if body != names[root] and int(model.body_parentid[body]) not in below:
            continue
        below.add(body)
        if body != names[root]:
            _joints(robot, model, body)
        _link(robot, model, body)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def _body(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body{body}"


def _joints(robot: ET.Element, model: mujoco.MjModel, body: int) -> None:
    """The chain of joints between a body's parent and the body.

    A body stands at T J1 J2 ... with T its fixed pose and Jk = move(p) turn(axis, q - ref) move(-p): the moves
    become the origins of the next joint, the turn back by ref a part of the joint's own origin.
    """
    parent = _body(model, int(model.body_parentid[body]))
    position: Vector = model.body_pos[body].copy()
    rotation = _matrix(model.body_quat[body])
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    for joint in range(first, first + count):
        anchor, axis = model.jnt_pos[joint], model.jnt_axis[joint]
        ref = float(model.qpos0[model.jnt_qposadr[joint]])
        title = model.joint(joint).name or f"joint{joint}"
        slide = _is_slide(model, joint, title)
        position += rotation @ (anchor - axis * ref if slide else anchor)
        if not slide:
            rotation = rotation @ _matrix(_turn(axis, -ref))
        plain = joint == first + count - 1 and not anchor.any()
        child = _body(model, body) if plain else f"{_body(model, body)}_{title}"
        element = _joint(robot, title, parent, child, position, rotation)
        _limits(element, model, joint, slide=slide)
        parent, position, rotation = child, -anchor, np.eye(3)
        if plain:
            return
        _inertial(ET.SubElement(robot, "link", name=child), _VIRTUAL_MASS_KG, np.zeros(3), np.eye(3),
                  np.full(3, _VIRTUAL_MASS_KG * 1e-3))
    _joint(robot, f"{_body(model, body)}_fixed", parent, _body(model, body), position, rotation).set("type", "fixed")


def _is_slide(model: mujoco.MjModel, joint: int, title: str) -> bool:
    kind = int(model.jnt_type[joint])
    if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        raise SimulationError("URDF has no ball or free joints", where=f"joint {title}",
                              mend="make it of hinges and slides, or name a root below it")
    return kind == mujoco.mjtJoint.mjJNT_SLIDE


def _joint(robot: ET.Element, title: str, parent: str, child: str, position: Vector, rotation: Vector) -> ET.Element:
    element = ET.SubElement(robot, "joint", name=title)
    _origin(element, position, rotation)
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    return element


def _limits(element: ET.Element, model: mujoco.MjModel, joint: int, *, slide: bool) -> None:
    limited = bool(model.jnt_limited[joint])
    element.set("type", "prismatic" if slide else "revolute" if limited else "continuous")
    ET.SubElement(element, "axis", xyz=_numbers(model.jnt_axis[joint]))
    low, high = model.jnt_range[joint] if limited else (-UNLIMITED, UNLIMITED)
    effort, velocity = _numbers([_effort(model, joint)]), _numbers([UNLIMITED])
    limit = ET.SubElement(element, "limit", effort=effort, velocity=velocity)
    if limited or slide:
        limit.set("lower", _numbers([low]))
        limit.set("upper", _numbers([high]))


def _effort(model: mujoco.MjModel, joint: int) -> float:
    """Largest force on a joint: its own limit, or that of the actuator that drives it [N m, N]."""
    if model.jnt_actfrclimited[joint]:
        return float(model.jnt_actfrcrange[joint][1])
    for actuator in range(model.nu):
        drives = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
        if drives and model.actuator_trnid[actuator][0] == joint and model.actuator_forcelimited[actuator]:
            return float(model.actuator_forcerange[actuator][1] * abs(model.actuator_gear[actuator][0]))
    return UNLIMITED


def _link(robot: ET.Element, model: mujoco.MjModel, body: int) -> None:
    link = ET.SubElement(robot, "link", name=_body(model, body))
    if model.body_mass[body] > 0:
        _inertial(link, float(model.body_mass[body]), model.body_ipos[body], _matrix(model.body_iquat[body]),
                  model.body_inertia[body])
    first = int(model.body_geomadr[body])
    for geom in range(first, first + int(model.body_geomnum[body])):
        if model.geom_group[geom] < _VISIBLE_GROUPS:
            _visuals(link, model, geom)


def _visuals(link: ET.Element, model: mujoco.MjModel, geom: int) -> None:
    size, rotation = model.geom_size[geom], _matrix(model.geom_quat[geom])
    kind, shapes = int(model.geom_type[geom]), mujoco.mjtGeom
    round_of_length = {"radius": _numbers([size[0]]), "length": _numbers([2 * size[1]])}
    ball = {"radius": _numbers([size[0]])}
    along = rotation[:, 2] * size[1]
    parts: list[tuple[str, dict[str, str], Vector]] = []
    if kind == shapes.mjGEOM_BOX:
        parts.append(("box", {"size": _numbers(2 * size)}, np.zeros(3)))
    elif kind == shapes.mjGEOM_SPHERE:
        parts.append(("sphere", ball, np.zeros(3)))
    elif kind == shapes.mjGEOM_CYLINDER:
        parts.append(("cylinder", round_of_length, np.zeros(3)))
    elif kind == shapes.mjGEOM_CAPSULE:
        parts += [("cylinder", round_of_length, np.zeros(3)), ("sphere", ball, along), ("sphere", ball, -along)]
    for shape, attributes, shift in parts:
        visual = ET.SubElement(link, "visual")
        _origin(visual, model.geom_pos[geom] + shift, rotation)
        ET.SubElement(ET.SubElement(visual, "geometry"), shape, attributes)
        material = ET.SubElement(visual, "material", name=f"geom{geom}")
        ET.SubElement(material, "color", rgba=_numbers(_colour(model, geom)))


def _colour(model: mujoco.MjModel, geom: int) -> Vector:
    material = int(model.geom_matid[geom])
    return model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]


def _inertial(link: ET.Element, mass: float, centre: Vector, rotation: Vector, inertia: Vector) -> None:
    element = ET.SubElement(link, "inertial")
    _origin(element, centre, rotation)
    ET.SubElement(element, "mass", value=_numbers([mass]))
    ixx, iyy, izz = (_numbers([value]) for value in inertia)
    ET.SubElement(element, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")


def _origin(element: ET.Element, position: Vector, rotation: Vector) -> None:
    ET.SubElement(element, "origin", xyz=_numbers(position), rpy=_numbers(_rpy(rotation)))


def _rpy(rotation: Vector) -> Vector:
    """Roll, pitch, yaw about fixed axes [rad]: R = Rz(yaw) Ry(pitch) Rx(roll); roll is 0 where pitch is +-90 deg."""
    flat = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    pitch = np.arctan2(-rotation[2, 0], flat)
    if flat < 1e-9:
        return np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])
    return np.array([np.arctan2(rotation[2, 1], rotation[2, 2]), pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])


def _matrix(quaternion: Vector) -> Vector:
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, np.asarray(quaternion, np.float64))
    return flat.reshape(3, 3)


def _turn(axis: Vector, angle: float) -> Vector:
    quaternion = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    return quaternion


def _numbers(values: Vector | list[float]) -> str:
    """Numbers as URDF writes them: ten digits, and 0 for what rounding left of it."""
    return " ".join(f"{float(v):.10g}" if abs(v) > 1e-15 else "0" for v in values)
