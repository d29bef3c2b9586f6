"""Playing: attempts of the training side from their scenes to their ends, and the scenes that the gate draws."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.curriculum import HardStart, spread_about
from pipeline.locomotion.scenes import hard_scene, legged_scenes, starts_of
from pipeline.locomotion.starts import as_data, from_data
from pipeline.locomotion.tasks import load_legged_task
from pipeline.locomotion.trying import trying
from pipeline.locomotion.varied import VariedWorld, vary
from pipeline.protocols import Observation, Policy
from pipeline.simulation.tasks import scene_seed
from schemas.scene import SceneSpec

NOISE = 97
"""Seed of the sensors' noise at the gate: candidate and champion meet the same."""


def play(policy: Policy, scenes: Sequence[SceneSpec], *, threads: int = 1) -> NDArray[np.bool_]:
    """Play every scene under its own draws; which attempts did not fall, shape (len(scenes),)."""
    body, task = load_legged(scenes[0].robot), load_legged_task(scenes[0].task)
    world = VariedWorld(body, task, [s.draws for s in scenes], seed=NOISE, threads=threads)
    ids, nothing = np.arange(world.n), np.zeros((world.n, 0))
    world.restart(ids, starts_of(scenes, body))
    policy.reset(world.n)
    stands = np.ones(world.n, bool)
    for tried in trying(lambda sensed: policy.act(Observation(sensed.astype(np.float64), nothing), ids), world,
                        task.ticks):
        stands = tried.stands
    return stands


def legged_gate_scenes(task: str, body: str, *, seed: int, generation: int, start: int, stop: int,
                       hard: Sequence[HardStart], hard_share: float, widen: float) -> list[SceneSpec]:
    """Scenes start..stop of the gate's sequence: robots that differ, starts of the common kinds and near falls.

    Kinds are interleaved, so that every look holds its shares; without a hard start all are drawn.

    Args:
        task, body: what is played.
        seed: of the run.
        generation: every generation has scenes of its own.
        start, stop: part of the sequence.
        hard: hard starts that no training has met; they follow each other, spread about what was sensed.
        hard_share: share of scenes that begin at them.
        widen: how much the robots differ, see pipeline.locomotion.varied.
    """
    common, made = load_legged_task(task).common, list[SceneSpec]()
    for i in range(start, stop):
        nth = int(i * hard_share)  # hard starts before this one; it is one itself where the next count is larger
        seeds = scene_seed("gate", seed, generation, i)
        rng = np.random.default_rng([23, seeds])
        if hard and int((i + 1) * hard_share) > nth:
            near = spread_about(from_data(hard[nth % len(hard)].start), 1.0, rng)
            scene = hard_scene(task, body, "gate", seeds, as_data(near))
        else:
            scene = legged_scenes(task, body, "gate", [(seeds, common[i % len(common)])])[0]
        made.append(scene.model_copy(update={"draws": vary(rng, widen)}))
    return made
