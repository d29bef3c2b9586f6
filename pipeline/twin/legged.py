"""A legged twin: one legged robot with hidden physics, drawn by seed, on which policies are deployed."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.played import played
from pipeline.locomotion.robots import LeggedRobots, Quirks
from pipeline.locomotion.tasks import LeggedTask, load_legged_task
from pipeline.locomotion.world import limits
from pipeline.protocols import Policy
from pipeline.simulation.rollout import Result
from pipeline.simulation.scenes import Contact
from pipeline.twin import legged_law
from schemas.scene import Draw, SceneSpec


@dataclass(frozen=True, slots=True)
class LeggedTwin:
    """The hidden physics of one legged robot; the same in every attempt."""

    seed: int
    draws: tuple[Draw, ...]

    @property
    def hidden(self) -> Mapping[str, float]:
        """What is hidden -> its value."""
        return {d.name: d.value for d in self.draws}


def draw_legged_twin(seed: int) -> LeggedTwin:
    """The twin of that seed, always the same."""
    rng = np.random.default_rng([0x1E66, seed])
    return LeggedTwin(seed, tuple(Draw(name=name, unit=unit, value=float(draw(rng)))
                                  for name, (unit, draw) in legged_law.LAW.items()))


def twin_robots(twin: LeggedTwin, scenes: Sequence[SceneSpec], *, threads: int) -> LeggedRobots:
    """Attempts on the twin, side by side; all of one robot and task."""
    task = load_legged_task(scenes[0].task)
    return LeggedRobots(twin_body(twin, load_legged(scenes[0].robot)), task, scenes, quirks=twin_quirks(twin, task),
                        contact=Contact.model_validate(dict(legged_law.CONTACT)), threads=threads)


def play_on_twin(policy: Policy, scenes: Sequence[SceneSpec], twin: LeggedTwin, *, threads: int,
                 with_rewards: bool = False) -> Result:
    """Play each attempt until it truly falls or its time is up; `success` says which never fell. Nothing is recorded.

    Raises:
        PolicyError: the policy was made for another robot or task.
    """
    return played(policy, twin_robots(twin, scenes, threads=threads), with_rewards=with_rewards)


def twin_quirks(twin: LeggedTwin, task: LeggedTask) -> Quirks:
    """What the twin's senses and motors do that training does not know."""
    h = twin.hidden
    return Quirks(
        delay_steps=round(h["delay_s"] * task.control_hz * task.substeps),
        turning_bias=(h["turning_bias"], -h["turning_bias"], h["turning_bias"]), turning_noise=h["turning_noise"],
        tilt_bias=(h["tilt_bias_x"], h["tilt_bias_y"]), tilt_noise=h["tilt_noise"], joint_bias=h["joint_bias"],
        joint_noise=h["joint_noise"], rate_noise=h["rate_noise"], blows=h["blows"], seed=twin.seed)


def twin_body(twin: LeggedTwin, body: LeggedBody) -> LeggedBody:
    """The robot as it really is: loaded, worn, and on other ground than its maker thinks."""
    h, spec, nominal = twin.hidden, body.spec.copy(), body.spec.copy().compile()
    mass, tall = float(nominal.body_mass.sum()), body.height_m
    side = 0.12 * tall
    spec.body(body.root).add_geom(
        name="payload", type=mujoco.mjtGeom.mjGEOM_BOX, size=[side / 2] * 3, mass=h["payload"] * mass, contype=0,
        conaffinity=0, pos=[tall * h["payload_x"], tall * h["payload_y"], tall * h["payload_z"]],
        rgba=(0.42, 0.38, 0.34, 1.0))
    reach = dict(zip(body.joints, limits(nominal), strict=True))
    for joint in spec.joints:
        if joint.name in reach:
            joint.damping = joint.damping * h["damping"]
            joint.frictionloss = joint.frictionloss + h["dry_friction"] * reach[joint.name]
    for motor in spec.actuators:
        _worn(motor, body.control, h)
    for geom in spec.geoms:
        if geom.contype:  # the feet: with a priority their own friction counts, not the larger of foot and ground
            geom.friction[0], geom.priority = h["ground"], 1
    return replace(body, spec=spec)


def _worn(motor: mujoco.MjsActuator, control: str, h: Mapping[str, float]) -> None:
    """A servo is softer and has less force; a motor gives less of the torque that it is asked for."""
    if control == "torque":
        motor.gainprm[0] = motor.gainprm[0] * h["strength"]
        return
    for parameters, k in ((motor.gainprm, 0), (motor.biasprm, 1), (motor.biasprm, 2)):
        parameters[k] = parameters[k] * h["stiffness"]
    motor.forcerange = [v * h["strength"] for v in motor.forcerange]
