"""LEGGED: the legged robots by name; changing the body of a task changes one word."""

from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

from pipeline.errors import unknown
from pipeline.locomotion.biped import biped
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.menagerie import legged_from_file, unitree_g1, unitree_h1

LEGGED: MappingProxyType[str, Callable[[], LeggedBody]] = MappingProxyType(
    {"biped": biped, "unitree_h1": unitree_h1, "unitree_g1": unitree_g1})
"""Robot name -> how to build it. Add one: a function that returns a LeggedBody, and an entry here."""


def load_legged(robot: str) -> LeggedBody:
    """The legged robot of that name, or the one in that MJCF or URDF file."""
    if robot in LEGGED:
        return LEGGED[robot]()
    if robot.endswith((".xml", ".urdf", ".mjcf")):
        return legged_from_file(Path(robot))
    raise unknown("body", robot, [*LEGGED, "PATH.xml", "PATH.urdf"])
