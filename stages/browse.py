"""Browse: what is played again to be looked at beside an episode; nothing of it is kept or learnt from."""

# mujoco is a compiled package without type stubs
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.protocols import Policy
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.urdf import robot_urdf
from pipeline.simulation.world import World
from pipeline.trace import Trace
from schemas.episode import Episode, Outcome, Segment


@dataclass(frozen=True, slots=True)
class Played:
    """One attempt at a scene."""

    episode: Episode
    trace: Trace
    attached: Mapping[str, bytes]
    """robot.urdf and scene.xml, as a recording carries them."""


def play_beside(episode: Episode, policies: Mapping[str, Policy]) -> dict[str, Played]:
    """Let policies attempt the scene of an episode in simulation.

    A start on a twin is played under nominal physics: nobody here knows the twin's.

    Args:
        episode: whose scene is played.
        policies: name -> policy; each has the scene for itself.

    Raises:
        SimulationError: the scene cannot be built.
    """
    scene = episode.scene.model_copy(update={"twin": None})
    setup = compose(load_body(scene.robot), scene.scene)
    attached = {"scene.xml": setup.xml.encode(),
                "robot.urdf": robot_urdf(setup.model, setup.body.root, "arm").encode()}
    found: dict[str, Played] = {}
    for name, policy in policies.items():
        world = World(setup, [scene], from_draws([scene.draws]), threads=1)
        policy.reset(world.n)
        tracer = Tracer(world)
        success = bool(rollout(world, policy, tracer=tracer).success[0])
        (trace,) = tracer.traces()
        record = Episode(
            id=episode.id, origin="deployed", scene=scene, control_hz=world.control_hz, frames=len(trace),
            generation=episode.generation,
            outcome=Outcome(label="success" if success else "failure", judged_by="simulator"),
            segments=(Segment(kind="autonomous", start=0, stop=len(trace), actor=name),))
        found[name] = Played(record, trace, attached)
    return found
