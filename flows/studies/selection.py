"""Which half of a batch to keep: by an influence score, at random, or the half that the score likes least."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pipeline.lerobot_view.training_data import TrainingData
from pipeline.policies.influence import Influence, Tried
from pipeline.policies.table import policy_kind
from pipeline.worth.cupid import advantages, by_episode
from pipeline.worth.practice import NOISE, practise
from pipeline.worth.scenes import PRACTICE, worth_scenes
from schemas.recipe import Recipe

ATTEMPTS = 400
SCORED_WITH = 700_000
"""Seed of the policy whose influence is computed; it is none of those that are compared."""


def scores(data: TrainingData, episodes: Sequence[str], recipe: Recipe, rare: Sequence[str],
           seed: int) -> Mapping[str, float]:
    """Episode of a version -> its influence on success, by one policy trained on all of it and 400 attempts with noise.

    The attempts start from scenes of their own, which nothing else plays.
    """
    kind = policy_kind(recipe.train.policy)
    fitted = kind.fit(data, recipe.train, SCORED_WITH, resume_from=None, checkpoints=None, progress=None)
    scenes = worth_scenes(recipe, rare, ATTEMPTS, seed=seed, words=PRACTICE)
    with TemporaryDirectory(prefix="hardcase-") as folder:
        kind.export(fitted, Path(folder) / "policy.onnx")
        done = practise(kind.open(Path(folder) / "policy.onnx"), scenes, fitted.action_std, seed=seed)
    tried = Tried(done.state, done.environment, done.noise, done.attempt, advantages(done, NOISE))
    rows = np.sort(np.concatenate(list(data.rows.values())))
    return by_episode(Influence(fitted, tried, data).of(data.gather(rows, recipe.train.chunk)), rows, data, episodes)


def halves(batch: Sequence[str], scored: Mapping[str, float], seed: int) -> dict[str, tuple[str, ...]]:
    """Way of choosing -> the half of the batch that is left out."""
    ranked = sorted(batch, key=lambda e: scored[e])
    order = np.random.default_rng([53, seed]).permutation(len(ranked))
    half = len(ranked) // 2
    return {"the better half by influence": tuple(ranked[:half]),
            "a random half": tuple(ranked[int(k)] for k in order[:half]),
            "the worse half by influence": tuple(ranked[len(ranked) - half:])}
