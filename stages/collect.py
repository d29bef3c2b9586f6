"""Collect: the scripted expert demonstrates the task in the nominal simulation."""

from collections.abc import Mapping
from pathlib import Path

from pipeline.simulation.bodies import load_body
from pipeline.simulation.expert import Expert, ExpertConfig
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.recordings import Recorded, episode_id, record
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.world import World
from schemas.episode import Episode, Outcome, Segment
from schemas.recipe import Recipe


def collect(recipe: Recipe, *, seed: int, folder: Path, software: Mapping[str, str]) -> list[Recorded]:
    """Record demonstrations at common starts; failures are kept, labelled as such.

    Args:
        recipe: robot, scene, task and number of demonstrations.
        seed: decides the starts; the same seed gives the same files.
        folder: where the MCAP files are written.
        software: strings for each file's metadata record.
    """
    common = load_task(recipe.task).common
    scenes = [sample_scene(recipe.task, "demo", scene_seed("demo", seed, i), common[i % len(common)],
                           robot=recipe.robot, scene=recipe.scene) for i in range(recipe.collect.demonstrations)]
    setup = compose(load_body(recipe.robot), recipe.scene)
    world, expert = World(setup, scenes, from_draws([()] * len(scenes)), threads=recipe.threads), Expert()
    expert.reset(world.n)
    tracer = Tracer(world)
    result = rollout(world, expert, horizon=recipe.collect.max_ticks, tracer=tracer)
    traces = tracer.traces()
    episodes = [
        Episode(
            id=episode_id("scripted", scene), origin="scripted", scene=scene, control_hz=world.control_hz,
            frames=len(trace), generation=0, segments=(Segment(kind="demonstration", start=0, stop=len(trace),
                                                               actor="expert"),),
            outcome=Outcome(label="success" if ok else "failure", judged_by="simulator"))
        for scene, trace, ok in zip(scenes, traces, result.success, strict=True)
    ]
    return record(folder, setup, episodes, traces, config=ExpertConfig().model_dump(), software=software)
