"""Layers composed: a scene built around a robot body, compiled once."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from dataclasses import dataclass

import mujoco

from pipeline.simulation.bodies import Body, load_body
from pipeline.simulation.scenes import NOMINAL, Contact, add_scene


@dataclass(frozen=True, slots=True)
class Setup:
    """A compiled robot in its scene, the robot alone for kinematics, and the names of its joints."""

    body: Body
    model: mujoco.MjModel
    """Robot and scene."""
    robot_model: mujoco.MjModel
    """The nominal robot alone, without contacts: what a controller knows of its own kinematics."""
    xml: str
    """MJCF of `model`, kept beside every recording."""


def compose(body: Body, scene: str, contact: Contact = NOMINAL, nominal: Body | None = None) -> Setup:
    """Build the scene around `body` and compile.

    Args:
        body: the robot as simulated.
        scene: key of SCENES.
        contact: contact model of the scene.
        nominal: the robot as its controller believes it to be; `body` itself where None.
    """
    alone = (nominal or body).spec.copy()
    # Kinematics asks where the tool is, nothing else: no contact, limit or dry friction needs to be set up for it.
    alone.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    spec = body.spec.copy()
    add_scene(spec, scene, contact)
    model = spec.compile()
    return Setup(body, model, alone.compile(), spec.to_xml())


def compile_model(robot: str, scene: str) -> mujoco.MjModel:
    """The nominal model of a robot in a scene."""
    return compose(load_body(robot), scene).model
