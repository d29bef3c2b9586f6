"""A robot out of its URDF: the shapes of its links, and where the links are for given joints."""

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from pipeline.browsing.shown import Colour, Shape
from pipeline.errors import RecordingError
from pipeline.trace import Rows

_GREY: Colour = (200, 200, 205, 255)


@dataclass(frozen=True, slots=True)
class Joint:
    """How a link hangs on its parent."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: tuple[float, ...]
    turn: tuple[float, ...]
    """Quaternion w, x, y, z."""
    axis: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Urdf:
    """What a viewer needs of a robot."""

    links: Mapping[str, tuple[Shape, ...]]
    """Link -> its drawn shapes; meshes are left out, the recording does not hold their files."""
    joints: tuple[Joint, ...]


def read_urdf(text: bytes, where: object) -> Urdf:
    """Links and joints of a URDF.

    Raises:
        RecordingError: it is no URDF, or declares entities, which can be made to fill the memory.
    """
    try:
        if b"<!ENTITY" in text:
            raise ValueError("it declares entities")
        robot = ET.fromstring(text)
        links = {link.attrib["name"]: tuple(_shapes(link)) for link in robot.findall("link")}
        return Urdf(links, tuple(_joint(joint) for joint in robot.findall("joint")))
    except (ET.ParseError, KeyError, ValueError) as error:
        raise RecordingError(f"robot.urdf cannot be read ({error})", where=where,
                             mend="attach a URDF with named links and joints, or none") from error


def poses(urdf: Urdf, values: Mapping[str, Rows]) -> dict[str, Rows]:
    """Link -> x, y, z [m], qw, qx, qy, qz at every moment, shape (m, 7); the root stands at the origin.

    Args:
        urdf: the robot.
        values: joint -> angle [rad] or travel [m], shape (m,); joints without values stand at 0.

    Source: ROS URDF specification: child = parent * origin * motion(axis, value).
    """
    m = max((len(v) for v in values.values()), default=1)
    children = {joint.child for joint in urdf.joints}
    still = np.tile([0.0, 0, 0, 1, 0, 0, 0], (m, 1))
    found = {name: still for name in urdf.links if name not in children}
    waiting = list(urdf.joints)
    while ready := [joint for joint in waiting if joint.parent in found]:
        for joint in ready:
            value = values.get(joint.name, np.zeros(m))
            found[joint.child] = _moved(found[joint.parent], joint, value)
            waiting.remove(joint)
    return found


def multiply(a: Rows, b: Rows) -> Rows:
    """Products of quaternions w, x, y, z, shape (m, 4)."""
    w, x, y, z = np.moveaxis(a, -1, 0)
    v, i, j, k = np.moveaxis(b, -1, 0)
    return np.stack([w * v - x * i - y * j - z * k, w * i + x * v + y * k - z * j,
                     w * j - x * k + y * v + z * i, w * k + x * j - y * i + z * v], axis=-1)


def turned(turn: Rows, vector: Rows) -> Rows:
    """Vectors (m, 3) turned by quaternions (m, 4)."""
    part = 2 * np.cross(turn[:, 1:], vector)
    return vector + turn[:, :1] * part + np.cross(turn[:, 1:], part)


def yawed(yaw: Rows) -> Rows:
    """Quaternions of turns about z [rad], shape (m, 4)."""
    zero = np.zeros_like(yaw)
    return np.stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)], axis=-1)


def _moved(parent: Rows, joint: Joint, value: Rows) -> Rows:
    m = len(value)
    place = parent[:, :3] + turned(parent[:, 3:], np.tile(joint.xyz, (m, 1)))
    turn = multiply(parent[:, 3:], np.tile(joint.turn, (m, 1)))
    axis = np.asarray(joint.axis)
    if joint.kind == "prismatic":
        place = place + turned(turn, value[:, None] * axis)
    elif joint.kind in ("revolute", "continuous"):
        half = value[:, None] / 2
        turn = multiply(turn, np.concatenate([np.cos(half), np.sin(half) * axis], axis=1))
    return np.concatenate([place, turn], axis=1)


def _joint(element: ET.Element) -> Joint:
    xyz, turn = _origin(element)
    axis, parent, child = element.find("axis"), element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise ValueError(f"joint {element.get('name')!r} joins nothing")
    along = _numbers(axis.get("xyz", "1 0 0")) if axis is not None else (1.0, 0.0, 0.0)
    length = float(np.linalg.norm(along)) or 1.0
    return Joint(element.attrib["name"], element.get("type", "fixed"), parent.attrib["link"], child.attrib["link"],
                 xyz, turn, tuple(a / length for a in along))


def _shapes(link: ET.Element) -> list[Shape]:
    found: list[Shape] = []
    for visual in link.findall("visual"):
        xyz, turn = _origin(visual)
        shown = visual.find("material/color")
        colour = _colour(_numbers(shown.attrib["rgba"])) if shown is not None else _GREY
        for shape in visual.findall("geometry/*"):
            if shape.tag == "box":
                x, y, z = (v / 2 for v in _numbers(shape.attrib["size"]))
                found.append(Shape("box", (x, y, z), xyz, turn, colour))
            elif shape.tag == "cylinder":
                size = (float(shape.attrib["radius"]), 0.0, float(shape.attrib["length"]) / 2)
                found.append(Shape("cylinder", size, xyz, turn, colour))
            elif shape.tag == "sphere":
                found.append(Shape("sphere", (float(shape.attrib["radius"]), 0.0, 0.0), xyz, turn, colour))
    return found


def _origin(element: ET.Element) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    origin = element.find("origin")
    if origin is None:
        return (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    x, y, z = _numbers(origin.get("xyz", "0 0 0"))
    roll, pitch, yaw = _numbers(origin.get("rpy", "0 0 0"))
    turn = np.array([1.0, 0, 0, 0])
    for angle, axis in ((yaw, 3), (pitch, 2), (roll, 1)):  # fixed axes: roll is applied first
        step = np.zeros(4)
        step[0], step[axis] = np.cos(angle / 2), np.sin(angle / 2)
        turn = multiply(turn[None], step[None])[0]
    a, b, c, d = (float(v) for v in turn)
    return (x, y, z), (a, b, c, d)


def _numbers(text: str) -> tuple[float, ...]:
    found = tuple(float(word) for word in text.split())
    if not np.isfinite(found).all():
        raise ValueError(f"numbers {text!r}")
    return found


def _colour(rgba: tuple[float, ...]) -> Colour:
    r, g, b, a = (round(255 * min(max(v, 0.0), 1.0)) for v in rgba)
    return r, g, b, a
