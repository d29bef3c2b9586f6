"""Exam: the same twin starts in every generation, judged by truth; read by the report and by no decision."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array, Policy
from pipeline.simulation.appearance import Look
from pipeline.simulation.eyes import with_eyes
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from pipeline.statistics import deployment_mix, wilson
from pipeline.twin.look import twin_look
from pipeline.twin.twin import draw_twin, twin_world
from schemas.recipe import Recipe
from schemas.scene import SceneSpec
from schemas.verdict import Proportion


@dataclass(frozen=True, slots=True)
class ExamResult:
    """One policy's exam; rows are scenes, the same for every policy of a run."""

    success: NDArray[np.bool_]
    strata: tuple[str, ...]
    rewards: dict[str, Array]
    """Reward term -> mean by tick."""


def exam(policy: Policy, recipe: Recipe, *, seed: int, twin: int, look: Look | None = None) -> ExamResult:
    """Play every exam scene on the twin; for a policy that sees it looks as the twin does, or as `look` says."""
    scenes = exam_scenes(recipe, seed=seed, twin=twin)
    world = twin_world(draw_twin(twin), scenes, threads=recipe.threads)
    policy.reset(world.n)
    with with_eyes(policy, world, [look or twin_look(twin)] * world.n) as driver:
        result = rollout(world, driver, with_rewards=True)
    return ExamResult(result.success, tuple(s.stratum for s in scenes), result.rewards)


def exam_scenes(recipe: Recipe, *, seed: int, twin: int) -> list[SceneSpec]:
    """The exam of a run: common starts, then rare ones split by the strata's shares."""
    task = load_task(recipe.task)
    counts = {name: recipe.exam.common // len(task.common) for name in task.common}
    counts |= {name: max(1, round(recipe.exam.rare * share)) for name, share in task.rare.items()}
    scenes: list[SceneSpec] = []
    for name, count in counts.items():
        scenes += [sample_scene(recipe.task, "exam", scene_seed("exam", seed, len(scenes) + i), name,
                                robot=recipe.robot, scene=recipe.scene, twin=twin) for i in range(count)]
    return scenes


def success_by(success: NDArray[np.bool_], strata: tuple[str, ...], recipe: Recipe) -> dict[str, Proportion]:
    """Success of all scenes, of common and of rare starts, at the deployment mix, and of each stratum.

    'all' counts the exam's scenes as they are; 'deployment_mix' weighs the strata as they are met at work.
    """
    task, names = load_task(recipe.task), np.array(strata)
    by = {name: wilson(int(success[names == name].sum()), int((names == name).sum())) for name in dict.fromkeys(strata)}
    rare = np.isin(names, list(task.rare))
    share = recipe.deploy.rare_share
    shares = {name: (1 - share) / len(task.common) for name in task.common}
    shares |= {name: share * s / sum(task.rare.values()) for name, s in task.rare.items()}
    return {"all": wilson(int(success.sum()), len(success)),
            "common": wilson(int(success[~rare].sum()), int((~rare).sum())),
            "rare": wilson(int(success[rare].sum()), int(rare.sum())),
            "deployment_mix": deployment_mix(by, shares), **by}
