"""Worth: a batch of episodes is judged by policies retrained with it and without it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, cast

from pipeline.errors import ConfigError
from pipeline.files import short_id
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.protocols import Policy
from pipeline.worth.judging import families, kinds, ruled, stacked
from pipeline.worth.scenes import worth_scenes
from pipeline.worth.trial import Played, play
from pipeline.worth.trials import PROCESSES, Progress, Trial, code_hash, run_trials
from pipeline.worth.without import without
from schemas.dataset import DatasetVersion
from schemas.recipe import Recipe
from schemas.scene import SceneSpec
from schemas.worth import LEAST_SEEDS, BatchWorth

SCENES = 200
WITH, WITHOUT = 500_000, 600_000
"""First training seeds of each side: no seed trains on both, and none is a run's own."""


def worth(version: DatasetVersion, data: TrainingData, batch: Sequence[str], recipe: Recipe, *, says: str,
          rare: Sequence[str], seed: int, keep: Path, seeds: int = LEAST_SEEDS, scenes: int = SCENES,
          processes: int = PROCESSES, progress: Progress | None = None) -> BatchWorth:
    """Retrain with the whole version and without the batch, play the same simulated scenes, and compare.

    The seeds of the two sides are other ones: they are unpaired draws, and are treated as such. Finished trainings
    are kept, so that what was cut off goes on where it was.

    Args:
        version: holds the batch.
        data: its frames in memory: TrainingData.load(store / version.path).
        batch: episodes of the version.
        recipe: trains, plays and names failures.
        says: what the batch is, in words.
        rare: kinds of start harvested so far; half of the scenes start in them, as in the gate.
        seed: of the run; decides the scenes, which are nobody else's.
        keep: folder of finished trainings.
        seeds: trainings on each side; fewer than 8 decide nothing.
        scenes: played by each policy.
        processes: trainings side by side.
        progress: told (trainings done, trainings in all).

    Raises:
        ConfigError: fewer than one seed, or fewer than 20 scenes.
        DatasetError: the batch is not of the version, or nothing is left without it.
        PolicyError: a training diverges.
    """
    if seeds < 1 or scenes < 20:
        raise ConfigError(f"{seeds} seeds on {scenes} scenes", where="hardcase worth",
                          mend=f"give at least 1 seed ({LEAST_SEEDS} decide) and 20 scenes: --seeds 8 --scenes 200")
    rest = without(data, version.episodes, batch)
    played = worth_scenes(recipe, rare, scenes, seed=seed)
    sides = (range(WITH, WITH + seeds), range(WITHOUT, WITHOUT + seeds))
    trials = [Trial(side, s) for pair in zip(*sides, strict=True) for side, s in zip((data, rest), pair, strict=True)]
    found = run_trials(trials, recipe, played, keep=keep, processes=processes, progress=progress)
    return _verdict(version, batch, says, recipe, played, (tuple(sides[0]), tuple(sides[1])),
                    (found[::2], found[1::2]))


def indicative(version: DatasetVersion, data: TrainingData, batch: Sequence[str], recipe: Recipe, policy: Policy, *,
               trained_with: int, says: str, rare: Sequence[str], seed: int, keep: Path,
               scenes: int = SCENES) -> BatchWorth:
    """The same from one extra training, beside a policy that was trained with the batch already; it decides nothing.

    Args:
        policy: trained on the whole version with seed `trained_with`; the other arguments are those of `worth`.
    """
    played = worth_scenes(recipe, rare, scenes, seed=seed)
    rest = without(data, version.episodes, batch)
    beside = run_trials([Trial(rest, WITHOUT)], recipe, played, keep=keep, processes=1)
    return _verdict(version, batch, says, recipe, played, ((trained_with,), (WITHOUT,)),
                    ([play(policy, played, recipe.harvest)], beside))


def _verdict(version: DatasetVersion, batch: Sequence[str], says: str, recipe: Recipe, scenes: Sequence[SceneSpec],
             seeds: tuple[tuple[int, ...], tuple[int, ...]],
             played: tuple[Sequence[Played], Sequence[Played]]) -> BatchWorth:
    """Compare what both sides did, and write it down."""
    parts, overall = kinds([s.stratum for s in scenes], (stacked(played[0]), stacked(played[1])))
    decision, reason, more = ruled(parts, overall, min(map(len, seeds)))
    name = batch_id(batch)
    return BatchWorth(
        id=short_id("worth", version.id, name, recipe.train.model_dump_json(), *seeds, code_hash(recipe.train),
                    *(s.model_dump_json() for s in scenes)),
        version=version.id, batch=name, says=says, episodes=tuple(batch), reason=reason, more_seeds=more,
        decision=cast(Literal["HELPS", "HURTS", "INCONCLUSIVE"], decision), seeds_with=seeds[0],
        seeds_without=seeds[1], parts=parts, families=families(*played))


def batch_id(batch: Sequence[str]) -> str:
    """A batch is its episodes, in whatever order they were named."""
    return short_id("batch", *sorted(batch))
