"""Evaluation: play scenes with a policy and keep seeds and results only; no recording is made."""

from collections.abc import Sequence

import numpy as np

from pipeline.protocols import Policy
from pipeline.simulation.appearance import look_from, randomize_look
from pipeline.simulation.bodies import load_body
from pipeline.simulation.eyes import with_eyes
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws, randomize
from pipeline.simulation.rollout import Result, rollout
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from pipeline.simulation.world import World
from schemas.scene import SceneSpec


def evaluate(policy: Policy, scenes: Sequence[SceneSpec], *, threads: int, with_rewards: bool = False) -> Result:
    """Play scenes of the training-side simulation, each under its own draws; rendered only for a policy that sees."""
    setup = compose(load_body(scenes[0].robot), scenes[0].scene)
    world = World(setup, scenes, from_draws([s.draws for s in scenes]), threads=threads)
    policy.reset(world.n)
    with with_eyes(policy, world, [look_from(s.draws) for s in scenes]) as driver:
        return rollout(world, driver, with_rewards=with_rewards)


def gate_scenes(task: str, robot: str, scene: str, *, seed: int, generation: int, start: int, stop: int,
                rare: Sequence[str], rare_share: float, appearance: bool = False) -> list[SceneSpec]:
    """Scenes start..stop of the gate's sequence: randomized physics, starts from the common and the harvested strata.

    Strata are interleaved, so that every look holds its shares; without a harvested stratum all are common.

    Args:
        task, robot, scene: what is played.
        seed: of the run.
        generation: every generation has scenes of its own.
        start, stop: part of the sequence.
        rare: strata harvested so far.
        rare_share: share of scenes that start in them.
        appearance: draw what each scene looks like, too: the gate of a policy that sees.
    """
    common = load_task(task).common
    made: list[SceneSpec] = []
    for i in range(start, stop):
        nth = int(i * rare_share)  # rare starts before this one; it is rare itself where the next count is larger
        is_rare = bool(rare) and int((i + 1) * rare_share) > nth
        stratum = rare[nth % len(rare)] if is_rare else common[i % len(common)]
        words = scene_seed("gate", seed, generation, i)
        drawn = randomize(np.random.default_rng([23, words]))
        if appearance:
            drawn = (*drawn, *randomize_look(np.random.default_rng([29, words])))
        made.append(sample_scene(task, "gate", words, stratum, robot=robot, scene=scene)
                    .model_copy(update={"draws": drawn}))
    return made
