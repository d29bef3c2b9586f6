"""The scenes on which the worth of a batch is measured: training-side simulation, seeds of their own."""

from collections.abc import Sequence

import numpy as np

from pipeline.simulation.physics import randomize
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from schemas.recipe import Recipe
from schemas.scene import SceneSpec

WORTH, PRACTICE = 0x776F727468, 0x7072616374
"""First words of the seeds: of scenes that judge, and of scenes that a score may look at beforehand."""


def worth_scenes(recipe: Recipe, rare: Sequence[str], n: int, *, seed: int, words: int = WORTH) -> list[SceneSpec]:
    """Scenes with randomized physics, laid out as the gate's: common starts and those of the harvested kinds.

    They are of the family 'study', so no demonstration, variant, gate or exam starts from one of them.

    Args:
        recipe: task, robot, scene, and the share of scenes from harvested kinds (gate.rare_share).
        rare: kinds of start harvested so far; all scenes are common where there is none.
        n: how many.
        seed: of the run.
        words: WORTH, or PRACTICE.
    """
    common, made = load_task(recipe.task).common, list[SceneSpec]()
    for i in range(n):
        nth = int(i * recipe.gate.rare_share)  # rare starts before this one
        is_rare = bool(rare) and int((i + 1) * recipe.gate.rare_share) > nth
        stratum = rare[nth % len(rare)] if is_rare else common[i % len(common)]
        drawn = scene_seed("study", words, seed, i)
        made.append(sample_scene(recipe.task, "study", drawn, stratum, robot=recipe.robot, scene=recipe.scene)
                    .model_copy(update={"draws": randomize(np.random.default_rng([29, drawn]))}))
    return made
