"""Scenes of a night: fresh ones for the test, others that choose among trainings, and those that must not be lost."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from pipeline.simulation.physics import randomize
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from schemas.scene import SceneFamily, SceneSpec

NIGHT_BASE: MappingProxyType[SceneFamily, int] = MappingProxyType({"selection": 8, "regression": 9})
"""First word of the seeds of families that only nights have, as FAMILY_BASE of pipeline.simulation.tasks for others."""

CANDIDATE, ANCHOR = 1, 2
"""Sequences of a night: for the candidate against the champion, and against the anchor."""


def night_mix(task: str, rare: Sequence[str], rare_share: float) -> dict[str, float]:
    """Family of starts -> its share of the test scenes; all common without a harvested kind.

    Args:
        task: what is played.
        rare: strata harvested so far.
        rare_share: share of scenes that start in them.
    """
    common = load_task(task).common
    kinds = {name: (1 - rare_share if rare else 1.0) / len(common) for name in common}
    return kinds | {name: rare_share / len(rare) for name in rare}


def night_scenes(task: str, robot: str, scene: str, *, seed: int, generation: int, sequence: int, start: int,
                 stop: int, mix: Mapping[str, float]) -> list[SceneSpec]:
    """Test scenes start..stop of a night: randomized physics, each family drawn from the mix by the scene's own seed.

    Drawn and not taken in turn: only where every scene is a draw of the same mix are the bets on each of them fair.

    Args:
        task, robot, scene: what is played.
        seed: of the run.
        generation: every night has scenes of its own.
        sequence: CANDIDATE or ANCHOR.
        start, stop: part of the sequence.
        mix: family -> share, summing to 1.
    """
    return [_drawn(task, robot, scene, "gate", scene_seed("gate", sequence, seed, generation, i), mix)
            for i in range(start, stop)]


def selection_scenes(task: str, robot: str, scene: str, *, seed: int, generation: int, n: int,
                     mix: Mapping[str, float]) -> list[SceneSpec]:
    """The scenes that choose among the trainings of a lap; no test of any night plays one of them."""
    return [_drawn(task, robot, scene, "selection", _seed("selection", seed, generation, i), mix) for i in range(n)]


def played_again(start: SceneSpec, times: int) -> list[SceneSpec]:
    """One regression start so many times, in the training-side simulation, each with noise of its own.

    Its own physics are kept where it has draws; a start from a robot at work has none that may be known here, so each
    copy draws from the ranges of training.
    """
    seeds = [_seed("regression", start.seed >> 32, start.seed & 0xFFFFFFFF, k) for k in range(times)]
    return [start.model_copy(update={
        "family": "regression", "seed": seed, "twin": None,
        "draws": start.draws or randomize(np.random.default_rng([29, seed]))}) for seed in seeds]


def _drawn(task: str, robot: str, scene: str, family: SceneFamily, seed: int, mix: Mapping[str, float]) -> SceneSpec:
    at = float(np.random.default_rng([31, seed]).random())
    bounds = np.cumsum(list(mix.values()))
    stratum = list(mix)[min(int(np.searchsorted(bounds, at, side="right")), len(mix) - 1)]
    return (sample_scene(task, family, seed, stratum, robot=robot, scene=scene)
            .model_copy(update={"draws": randomize(np.random.default_rng([23, seed]))}))


def _seed(family: SceneFamily, *parts: int) -> int:
    """A 63-bit seed as scene_seed gives it, for the families of the night."""
    words = np.random.SeedSequence([NIGHT_BASE[family], *parts]).generate_state(2, np.uint32)
    return (NIGHT_BASE[family] << 59) | (int(words[0]) << 27) | (int(words[1]) >> 5)
