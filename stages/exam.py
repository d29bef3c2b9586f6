"""Exam: the same twin starts in every generation, judged by truth; read by the report and by no decision."""

import numpy as np
from numpy.typing import NDArray

from pipeline.exam import ExamResult, by_kind, exam_counts
from pipeline.protocols import Policy
from pipeline.simulation.appearance import Look
from pipeline.simulation.eyes import with_eyes
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from pipeline.twin.look import twin_look
from pipeline.twin.twin import draw_twin, twin_world
from schemas.recipe import Recipe
from schemas.scene import SceneSpec
from schemas.verdict import Proportion

__all__ = ["ExamResult", "exam", "exam_scenes", "success_by"]


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
    scenes: list[SceneSpec] = []
    for name, count in exam_counts(recipe.exam, task.common, task.rare).items():
        scenes += [sample_scene(recipe.task, "exam", scene_seed("exam", seed, len(scenes) + i), name,
                                robot=recipe.robot, scene=recipe.scene, twin=twin) for i in range(count)]
    return scenes


def success_by(success: NDArray[np.bool_], strata: tuple[str, ...], recipe: Recipe) -> dict[str, Proportion]:
    """Success by kind of start, see pipeline.exam.by_kind."""
    task = load_task(recipe.task)
    return by_kind(success, strata, task.common, task.rare, recipe.deploy.rare_share)
