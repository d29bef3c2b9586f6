"""Poisoned batches: built as real versions of a real lap, and shown to every door between the robot and a release."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from flows.run.steps import Steps
from pipeline.files import short_id
from pipeline.frames import Frames
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.policies.table import policy_kind
from pipeline.simulation.evaluation import evaluate, gate_scenes
from pipeline.simulation.tasks import load_task
from pipeline.worth.poison import POISONS
from schemas.contract import Contract
from schemas.dataset import DatasetVersion
from schemas.episode import Episode
from schemas.recipe import Recipe
from schemas.scene import SceneSpec
from stages.build import build
from stages.check import Item, check
from stages.gate import gate

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
    """Everything that the lap added."""
    poisoned: tuple[str, ...]
    """What of it is poisoned."""
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
    return Poisoned(version, data, batch, tuple(e for e in batch if e in bad), recipe, found)


def _frames(steps: Steps, bad: dict[str, Episode], poison: str, seed: int) -> Callable[[Episode], Frames]:
    task = load_task(steps.recipe.task)

    def get(episode: Episode) -> Frames:
        if episode.id not in bad:
            return steps.material.frames(episode)
        rng = np.random.default_rng([37, seed, int(episode.id[:8], 16)])
        return POISONS[poison](steps.material.frames(bad[episode.id]), task, rng)

    return get


def gated(steps: Steps, bad: Poisoned) -> str:
    """What the gate says of a candidate that learnt from a poisoned version, against the champion before that lap."""
    recipe, champion = bad.recipe, steps.store.releases(steps.run)[0].policy
    kind, candidate = policy_kind(recipe.train.policy), short_id("candidate", bad.version.id)
    fitted = kind.fit(bad.data, recipe.train, 1000 * steps.seed + LAP, resume_from=None, checkpoints=None,
                      progress=None)
    rare = sorted({c.stratum for c in steps.store.hard_cases(run=steps.run) if c.generation < LAP} - {"common"})

    def scenes(start: int, stop: int) -> list[SceneSpec]:
        return gate_scenes(recipe.task, recipe.robot, recipe.scene, seed=steps.seed, generation=LAP, start=start,
                           stop=stop, rare=rare, rare_share=recipe.gate.rare_share)

    with TemporaryDirectory(prefix="hardcase-") as folder:
        kind.export(fitted, Path(folder) / "policy.onnx")
        policies = {candidate: kind.open(Path(folder) / "policy.onnx"), champion: steps.policy(champion)}
        return gate(candidate, champion, generation=LAP, scenes=scenes, config=recipe.gate,
                    evaluate=lambda p, s: evaluate(policies[p], s, threads=1).success).decision
