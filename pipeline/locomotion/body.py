"""LeggedBody: a robot that stands on feet, as a spec that a scene is built around, and how it is commanded."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from dataclasses import dataclass
from itertools import combinations, product
from typing import Literal

import mujoco

type Control = Literal["position", "torque"]

SENSED_BY_FEET = "_touch"
"""Suffix of the touch sensor of a foot, after the foot's name."""


@dataclass(frozen=True, slots=True)
class LeggedBody:
    """A floating robot whose actuated hinges are driven by servos or by torques."""

    spec: mujoco.MjSpec
    root: str
    """The floating base; the IMU sits on it."""
    joints: tuple[str, ...]
    """Actuated hinges, in the order of the actuators."""
    home: tuple[float, ...]
    """Posture that the robot stands in [rad]."""
    height_m: float
    """Height of the base's origin in that posture [m]."""
    feet: tuple[str, ...]
    """Bodies that stand on the ground."""
    control: Control
    """'position': an action moves the servos' targets around home; 'torque': it is a share of each motor's limit."""
    scale: float
    """What an action of 1 is: radians for servos, a share of the limit for torques."""
    rest: tuple[float, ...] | None = None
    """Torques that an action of 0 asks for [N m]; none where None. Of bodies under torque control."""


def add_touch(spec: mujoco.MjSpec, feet: tuple[str, ...], size_m: float = 0.3) -> None:
    """Give each foot a sensor of the force that presses on it [N], within a cube of edge `size_m` [m]."""
    for foot in feet:
        spec.body(foot).add_site(name=foot + SENSED_BY_FEET, type=mujoco.mjtGeom.mjGEOM_BOX,
                                 size=[size_m / 2] * 3, rgba=[0, 0, 0, 0])
        spec.add_sensor(name=foot + SENSED_BY_FEET, type=mujoco.mjtSensor.mjSENS_TOUCH,
                        objtype=mujoco.mjtObj.mjOBJ_SITE, objname=foot + SENSED_BY_FEET)


def let_feet_meet(spec: mujoco.MjSpec, feet: tuple[str, ...]) -> None:
    """Make feet solid for each other: what of them meets the ground then meets that of the other feet, too."""
    solid: dict[str, list[str]] = {}
    for foot in feet:
        geoms = [geom for geom in spec.body(foot).geoms if geom.contype or geom.conaffinity]
        for k, geom in enumerate(geoms):
            geom.name = geom.name or f"{foot}_solid_{k}"
        solid[foot] = [geom.name for geom in geoms]
    for one, other in combinations(feet, 2):
        for first, second in product(solid[one], solid[other]):
            spec.add_pair(geomname1=first, geomname2=second)
