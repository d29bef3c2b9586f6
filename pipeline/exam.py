"""Exam: what one policy did at the starts that no decision reads, and how its success is told by kind of start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array
from pipeline.statistics import deployment_mix, wilson
from schemas.recipe import ExamConfig
from schemas.verdict import Proportion


@dataclass(frozen=True, slots=True)
class ExamResult:
    """One policy's exam; rows are scenes, the same for every policy of a run."""

    success: NDArray[np.bool_]
    strata: tuple[str, ...]
    rewards: dict[str, Array]
    """Reward term -> mean by tick."""


def exam_counts(config: ExamConfig, common: Sequence[str], rare: Mapping[str, float]) -> dict[str, int]:
    """Kind of start -> scenes: the common ones in equal parts, then the rare ones by their shares."""
    counts = {name: config.common // len(common) for name in common}
    return counts | {name: max(1, round(config.rare * share)) for name, share in rare.items()}


def by_kind(success: NDArray[np.bool_], strata: Sequence[str], common: Sequence[str], rare: Mapping[str, float],
            rare_share: float) -> dict[str, Proportion]:
    """Success of all scenes, of common and of rare starts, at the deployment mix, and of each stratum.

    'all' counts the exam's scenes as they are; 'deployment_mix' weighs the strata as they are met at work.

    Args:
        success: scene by scene, shape (n,).
        strata: kind of start of each scene.
        common: kinds that are not rare.
        rare: rare kinds, and their shares among the rare starts.
        rare_share: share of rare starts at work.
    """
    names = np.array(strata)
    by = {name: wilson(int(success[names == name].sum()), int((names == name).sum())) for name in dict.fromkeys(strata)}
    is_rare = np.isin(names, list(rare))
    shares = {name: (1 - rare_share) / len(common) for name in common}
    shares |= {name: rare_share * s / sum(rare.values()) for name, s in rare.items()}
    return {"all": wilson(int(success.sum()), len(success)),
            "common": wilson(int(success[~is_rare].sum()), int((~is_rare).sum())),
            "rare": wilson(int(success[is_rare].sum()), int(is_rare.sum())),
            "deployment_mix": deployment_mix(by, shares), **by}
