"""Poisoned batches: built as real versions of a real lap, and shown to every door between the robot and a release."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from flows.steps import Steps
from pipeline.files import short_id
from pipeline.frames import Frames
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.simulation.tasks import load_task
from pipeline.worth.poison import POISONS
from schemas.contract import Contract
from schemas.dataset import DatasetVersion
from schemas.episode import Episode
from schemas.recipe import Recipe
from stages.build import build
from stages.check import Item, check

type Scope = Literal["corrections", "everything new"]

LAP = 1
"""The lap whose batch is poisoned: the first harvest is the largest."""


@dataclass(frozen=True, slots=True)
class Dose:
    """One poisoned batch."""

    poison: str
    scope: Scope
    share: float
    """Share of every training batch that corrections have."""


STEPS: tuple[tuple[Scope, float], ...] = (("everything new", 0.2), ("corrections", 0.2), ("corrections", 0.5))
DOSES: tuple[Dose, ...] = tuple(Dose(poison, scope, share) for scope, share in STEPS for poison in POISONS)


@dataclass(frozen=True, slots=True)
class Poisoned:
    """A poisoned version in memory, and what the checks said of its folder."""

    version: DatasetVersion
    data: TrainingData
    batch: tuple[str, ...]
    recipe: Recipe
    check: str


def poisoned(steps: Steps, dose: Dose, seed: int) -> Poisoned:
    """Build the version of the lap with a poisoned batch, check it, and read it.

    The bad episodes have ids of their own; what is not poisoned is the lap's. The folder is gone afterwards.
    """
    material, bad = steps.material, dict[str, Episode]()
    fresh = {e.id for e in (*material.fresh(LAP), *steps.store.episodes(material.ids(LAP, "augment")))}
    episodes: list[Episode] = []
    for episode in material.episodes(LAP):
        hit = episode.id in fresh and (dose.scope == "everything new" or episode.origin == "corrected")
        if hit and episode.outcome.label == "success":
            other = short_id("poisoned", dose.poison, episode.id)
            bad[other] = episode
            episode = episode.model_copy(update={"id": other})
        episodes.append(episode)
    shares = {"base": 1 - dose.share, "corrections": dose.share}
    recipe = steps.recipe.model_copy(update={
        "dataset": steps.recipe.dataset.model_copy(update={"weights": shares})})
    with TemporaryDirectory(prefix="hardcase-") as folder:
        version = build(episodes, _frames(steps, bad, dose.poison, seed), recipe, store=Path(folder), generation=LAP,
                        task=load_task(recipe.task).instruction, consents=material.consents())
        at = Path(folder) / version.path
        verdict = check([Item(at, version.id, trusted=True)], Contract())[0].verdict
        found = "not readable" if verdict is None else "passes" if verdict.passed else verdict.reason
        data = TrainingData.load(at, material.consents())
    batch = tuple(e for e in version.episodes if e in bad or e in fresh)
    return Poisoned(version, data, batch, recipe, found)


def _frames(steps: Steps, bad: dict[str, Episode], poison: str, seed: int) -> Callable[[Episode], Frames]:
    task = load_task(steps.recipe.task)

    def get(episode: Episode) -> Frames:
        if episode.id not in bad:
            return steps.material.frames(episode)
        rng = np.random.default_rng([37, seed, int(episode.id[:8], 16)])
        return POISONS[poison](steps.material.frames(bad[episode.id]), task, rng)

    return get
