"""Scenes: what stands around the robot (table, object, target, cameras, light)."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Callable
from types import MappingProxyType

import mujoco

from pipeline.errors import unknown
from schemas.base import Frozen


class Contact(Frozen):
    """Contact model and time step of a compiled scene."""

    timestep_s: float = 0.005
    elliptic: bool = False
    impratio: float = 1.0
    solref: tuple[float, float] = (0.02, 1.0)
    solimp: tuple[float, float, float] = (0.9, 0.95, 0.001)


NOMINAL = Contact()
TILES, TILE_M = ((0.80, 0.76, 0.70), (0.72, 0.68, 0.62)), 0.25
"""Colours and edge of the tiles of level ground, which show in a picture how far a robot has come."""


def table(spec: mujoco.MjSpec, contact: Contact = NOMINAL) -> None:
    """Around the robot in `spec`: a table at z = 0, one free cube, a target mark, two cameras and a light."""
    option = spec.option
    option.timestep = contact.timestep_s
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations = 20
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if contact.elliptic else mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.impratio = contact.impratio
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 640, 480
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.35] * 3, [0.45] * 3
    world = spec.worldbody
    world.add_light(pos=[0.2, -0.6, 1.4], dir=[0.1, 0.4, -1], diffuse=[0.6] * 3, castshadow=False)
    material = {"condim": 4, "solref": contact.solref, "solimp": (*contact.solimp, 0.5, 2)}
    world.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.9, 0.9, 0.05], contype=2, conaffinity=1,
                   friction=[1.0, 0.01, 0.0001], rgba=(0.80, 0.76, 0.70, 1), **material)
    cube = world.add_body(name="object", pos=[0.3, 0, 0.02])
    cube.add_freejoint(name="object")
    cube.add_geom(name="object", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02] * 3, mass=0.05, contype=3, conaffinity=3,
                  friction=[1.0, 0.01, 0.0001], rgba=(0.83, 0.22, 0.24, 1), **material)
    mark = world.add_body(name="target", pos=[0.3, 0.1, 0.0005], mocap=True)
    mark.add_geom(name="target", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.025, 0.0005, 0], contype=0,
                  conaffinity=0, rgba=(0.20, 0.62, 0.36, 0.9))
    world.add_camera(name="front", pos=[0.98, -0.42, 0.55], xyaxes=[0.42, 0.68, 0, -0.38, 0.24, 0.72], fovy=42)
    world.add_camera(name="top", pos=[0.31, 0, 1.0], xyaxes=[0, -1, 0, 1, 0, 0], fovy=42)


def ground(spec: mujoco.MjSpec, contact: Contact = NOMINAL) -> None:
    """Around the robot in `spec`: level ground at z = 0, a camera that stays beside it, and a light."""
    option = spec.option
    option.timestep = contact.timestep_s
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations, option.ls_iterations = 8, 10
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if contact.elliptic else mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.impratio = contact.impratio
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 640, 480
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.35] * 3, [0.45] * 3
    world = spec.worldbody
    world.add_light(pos=[0.5, -1.5, 3.0], dir=[-0.1, 0.4, -1], diffuse=[0.6] * 3, castshadow=False)
    tiles = spec.add_texture(name="tiles", type=mujoco.mjtTexture.mjTEXTURE_2D, width=64, height=64,
                             builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER, rgb1=TILES[0], rgb2=TILES[1])
    material = spec.add_material(name="tiles", texuniform=True, texrepeat=[1 / TILE_M / 2] * 2)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = tiles.name
    world.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[50, 50, 0.1], contype=2, conaffinity=1,
                   friction=[1.0, 0.01, 0.0001], rgba=(1, 1, 1, 1), material=material.name, solref=contact.solref,
                   solimp=(*contact.solimp, 0.5, 2))


SCENES: MappingProxyType[str, Callable[[mujoco.MjSpec, Contact], None]] = MappingProxyType(
    {"table": table, "ground": ground})
"""Scene name -> how to build it. Add one: a function that adds to the robot's spec, and an entry here."""


def add_scene(spec: mujoco.MjSpec, name: str, contact: Contact = NOMINAL) -> None:
    """Build the scene of that name around the robot in `spec`; ConfigError lists the valid names."""
    if name not in SCENES:
        raise unknown("scene", name, SCENES)
    SCENES[name](spec, contact)
