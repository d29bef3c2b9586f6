"""What stands around the robot, out of the scene that a recording carries: table, cube, mark."""

from xml.etree import ElementTree as ET

import numpy as np

from pipeline.browsing.shown import Body, Colour, Shape
from pipeline.browsing.urdf import yawed
from pipeline.trace import Rows
from schemas.scene import SceneSpec

_TABLE: Colour = (204, 194, 178, 255)
_CUBE: Colour = (212, 56, 61, 255)
_MARK: Colour = (51, 158, 92, 255)
_PERCEIVED: Colour = (255, 150, 150, 255)
_THICK_M = 0.01


def surroundings(scene: SceneSpec, xml: bytes | None) -> list[Body]:
    """Table and target of a simulated scene; none where the recording carries no scene.

    Args:
        scene: where the target is.
        xml: the recording's scene.xml; sizes and colours are taken from it.
    """
    geoms = _geoms(xml)
    found: list[Body] = []
    if (table := geoms.get("table")) is not None:
        size = _numbers(table, "size", (0.9, 0.9, 0.05))
        slab = Shape("box", (size[0] / 2, size[1] / 2, _THICK_M / 2), (0.25, 0.0, -_THICK_M / 2),
                     colour=_rgba(table, _TABLE))
        found.append(Body("table", (slab,), _still(0.0, 0.0, 0.0)))
    if (target := geoms.get("target")) is not None:
        radius, half, *_ = _numbers(target, "size", (0.025, 0.0005))
        disc = Shape("cylinder", (radius, 0.0, half), colour=(*_rgba(target, _MARK)[:3], 255))
        found.append(Body("target", (disc,), _still(*scene.target_xy_m, 0.001)))
    return found


def cube(scene: SceneSpec, xml: bytes | None) -> tuple[Shape, ...]:
    """The object as it is drawn; its colour is the scene's."""
    geom = _geoms(xml).get("object")
    half = scene.object_half_m
    return (Shape("box", (half, half, half), colour=_rgba(geom, _CUBE) if geom is not None else _CUBE),)


def perceived(environment: Rows, half_m: float) -> Body:
    """The object where the robot perceived it, as edges; see frames.ENVIRONMENT for the columns, shape (m, 7)."""
    poses = np.concatenate([environment[:, :3], yawed(environment[:, 3])], axis=1)
    edge = half_m * 1.02  # so that its edges are not inside the true one
    return Body("perceived", (Shape("box", (edge, edge, edge), colour=_PERCEIVED, solid=False),), poses)


def _geoms(xml: bytes | None) -> dict[str, ET.Element]:
    if xml is None or b"<!ENTITY" in xml:
        return {}
    try:
        return {geom.get("name", ""): geom for geom in ET.fromstring(xml).iter("geom")}
    except ET.ParseError:
        return {}  # a scene that does not parse hides nothing that the robot did


def _numbers(element: ET.Element, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in element.get(name, "").split()) or default
    except ValueError:
        return default


def _rgba(element: ET.Element, default: Colour) -> Colour:
    rgba = _numbers(element, "rgba", ())
    if len(rgba) != 4:
        return default
    r, g, b, a = (round(255 * min(max(v, 0.0), 1.0)) for v in rgba)
    return r, g, b, a


def _still(x: float, y: float, z: float) -> Rows:
    return np.array([[x, y, z, 1.0, 0.0, 0.0, 0.0]])
