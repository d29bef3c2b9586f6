"""The small biped: a torso on two legs with hip, knee and ankle, from primitives."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from types import MappingProxyType

import mujoco
import numpy as np
from pydantic import Field

from pipeline.locomotion.body import LeggedBody, add_touch
from schemas.base import Frozen


class Hinge(Frozen):
    """One hinge of a leg and its position servo."""

    axis: tuple[float, float, float]
    range_rad: tuple[float, float]
    kp: float = Field(gt=0, description="servo stiffness [N m/rad]")
    kv: float = Field(ge=0, description="servo damping [N m s/rad]")
    torque_limit: float = Field(gt=0, description="[N m]")
    home_rad: float
    damping: float = 0.5
    armature: float = Field(default=0.02, description="reflected rotor inertia [kg m^2]")


LEG = MappingProxyType({
    "hip_roll": Hinge(axis=(1, 0, 0), range_rad=(-0.5, 0.5), kp=60, kv=2.0, torque_limit=40, home_rad=0.0),
    "hip_pitch": Hinge(axis=(0, 1, 0), range_rad=(-1.6, 0.8), kp=60, kv=2.0, torque_limit=50, home_rad=-0.35),
    "knee": Hinge(axis=(0, 1, 0), range_rad=(0.0, 2.2), kp=60, kv=2.0, torque_limit=60, home_rad=0.70),
    "ankle_pitch": Hinge(axis=(0, 1, 0), range_rad=(-0.9, 0.7), kp=30, kv=1.0, torque_limit=20, home_rad=-0.35),
    "ankle_roll": Hinge(axis=(1, 0, 0), range_rad=(-0.4, 0.4), kp=20, kv=0.7, torque_limit=10, home_rad=0.0),
})
"""Hinges of one leg from the hip down; pitch turns about the y axis, so that a bent knee is positive."""


class BipedConfig(Frozen):
    """Lengths [m] and masses [kg] of the small biped: 12.3 kg, 0.95 m tall."""

    thigh: float = 0.34
    shin: float = 0.34
    hip_width: float = Field(default=0.16, description="between the hips")
    sole: float = Field(default=0.042, description="height of the ankle above the ground")
    torso_mass: float = 6.0
    thigh_mass: float = 1.4
    shin_mass: float = 0.9
    foot_mass: float = 0.3
    foot_half: tuple[float, float, float] = (0.09, 0.035, 0.012)
    foot_forward: float = 0.03
    torso_half: tuple[float, float, float] = (0.06, 0.10, 0.13)
    scale: float = Field(default=0.5, description="what an action of 1 moves a servo's target by [rad]")


BIPED = BipedConfig()
WHITE, BLUE, DARK = (0.90, 0.91, 0.93, 1.0), (0.20, 0.42, 0.74, 1.0), (0.16, 0.17, 0.20, 1.0)
FOOT = MappingProxyType({"contype": 1, "conaffinity": 2, "condim": 3, "friction": [0.9, 0.005, 0.0001]})
BODILESS = MappingProxyType({"contype": 0, "conaffinity": 0})


def biped(config: BipedConfig = BIPED) -> LeggedBody:
    """The small biped: ten hinges with servos; only its feet touch the ground."""
    spec = mujoco.MjSpec()
    spec.modelname, spec.compiler.degree = "hardcase-biped", False
    height = config.sole + config.thigh * np.cos(LEG["hip_pitch"].home_rad) + config.shin * np.cos(
        LEG["hip_pitch"].home_rad + LEG["knee"].home_rad)
    torso = spec.worldbody.add_body(name="torso", pos=[0, 0, float(height)])
    torso.add_freejoint(name="root")
    torso.add_geom(name="torso", type=mujoco.mjtGeom.mjGEOM_BOX, size=config.torso_half,
                   pos=[0, 0, config.torso_half[2]], mass=config.torso_mass, rgba=WHITE, **BODILESS)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        _leg(torso, side, sign, config)
    for side in ("left", "right"):
        for name, hinge in LEG.items():
            servo = spec.add_actuator(name=f"{side}_{name}", trntype=mujoco.mjtTrn.mjTRN_JOINT,
                                      target=f"{side}_{name}")
            servo.set_to_position(kp=hinge.kp, kv=hinge.kv)
            servo.forcelimited, servo.forcerange = True, [-hinge.torque_limit, hinge.torque_limit]
    feet = ("left_foot", "right_foot")
    add_touch(spec, feet)
    return LeggedBody(spec, "torso", tuple(f"{side}_{name}" for side in ("left", "right") for name in LEG),
                      tuple(hinge.home_rad for _ in range(2) for hinge in LEG.values()), float(height), feet,
                      "position", config.scale)


def _leg(torso: mujoco.MjsBody, side: str, sign: float, config: BipedConfig) -> None:
    capsule, sphere = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE
    hip = torso.add_body(name=f"{side}_hip", pos=[0, sign * config.hip_width / 2, 0])
    _hinge(hip, side, "hip_roll")
    hip.add_geom(type=sphere, size=[0.03, 0, 0], mass=0.4, rgba=DARK, **BODILESS)
    thigh = hip.add_body(name=f"{side}_thigh")
    _hinge(thigh, side, "hip_pitch")
    thigh.add_geom(type=capsule, fromto=[0, 0, 0, 0, 0, -config.thigh], size=[0.03, 0, 0], mass=config.thigh_mass,
                   rgba=BLUE, **BODILESS)
    shin = thigh.add_body(name=f"{side}_shin", pos=[0, 0, -config.thigh])
    _hinge(shin, side, "knee")
    shin.add_geom(type=capsule, fromto=[0, 0, 0, 0, 0, -config.shin], size=[0.025, 0, 0], mass=config.shin_mass,
                  rgba=WHITE, **BODILESS)
    ankle = shin.add_body(name=f"{side}_ankle", pos=[0, 0, -config.shin])
    _hinge(ankle, side, "ankle_pitch")
    ankle.add_geom(type=sphere, size=[0.02, 0, 0], mass=0.1, rgba=DARK, **BODILESS)
    foot = ankle.add_body(name=f"{side}_foot")
    _hinge(foot, side, "ankle_roll")
    foot.add_geom(name=f"{side}_foot", type=mujoco.mjtGeom.mjGEOM_BOX, size=config.foot_half,
                  pos=[config.foot_forward, 0, -config.sole + config.foot_half[2]], mass=config.foot_mass, rgba=BLUE,
                  **FOOT)


def _hinge(body: mujoco.MjsBody, side: str, name: str) -> None:
    hinge = LEG[name]
    body.add_joint(name=f"{side}_{name}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=hinge.axis, range=hinge.range_rad,
                   limited=True, damping=hinge.damping, armature=hinge.armature)
