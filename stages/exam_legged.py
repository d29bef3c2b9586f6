"""Exam of a legged robot: the same twin starts in every generation, judged by truth; read by no decision."""

import numpy as np
from numpy.typing import NDArray

from pipeline.exam import ExamResult, by_kind, exam_counts
from pipeline.locomotion.scenes import legged_scenes
from pipeline.locomotion.tasks import load_legged_task
from pipeline.protocols import Policy
from pipeline.simulation.tasks import scene_seed
from pipeline.twin.legged import draw_legged_twin, play_on_twin
from schemas.recipe import Recipe
from schemas.scene import SceneSpec
from schemas.verdict import Proportion


def exam_legged(policy: Policy, recipe: Recipe, *, seed: int, twin: int) -> ExamResult:
    """Play every exam scene on the twin; an attempt succeeds that never falls."""
    scenes = exam_legged_scenes(recipe, seed=seed, twin=twin)
    result = play_on_twin(policy, scenes, draw_legged_twin(twin), threads=recipe.threads, with_rewards=True)
    return ExamResult(result.success, tuple(s.stratum for s in scenes), result.rewards)


def exam_legged_scenes(recipe: Recipe, *, seed: int, twin: int) -> list[SceneSpec]:
    """The exam of a run: common starts, then rare ones split by the shares of their kinds."""
    task = load_legged_task(recipe.task)
    kinds = [name for name, n in exam_counts(recipe.exam, task.common, task.rare).items() for _ in range(n)]
    drawn = [(scene_seed("exam", seed, i), name) for i, name in enumerate(kinds)]
    return legged_scenes(recipe.task, recipe.robot, "exam", drawn, twin)


def stands_by(success: NDArray[np.bool_], strata: tuple[str, ...], recipe: Recipe) -> dict[str, Proportion]:
    """Attempts that did not fall, by kind of start, see pipeline.exam.by_kind."""
    task = load_legged_task(recipe.task)
    return by_kind(success, strata, task.common, task.rare, recipe.deploy.rare_share)
