"""From how the scenes ended to a verdict on the batch."""

from collections.abc import Mapping, Sequence
from math import ceil
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from pipeline.statistics import holm
from pipeline.statistics.retraining import Retrained, retrained
from pipeline.worth.trial import Played
from schemas.worth import LEAST_SEEDS, WorthPart

ALPHA = 0.05
"""Chance that a batch which changes nothing is called helpful or harmful."""
ALL = "all"
POWER = 0.8

type Runs = NDArray[np.bool_]
type Both = tuple[Runs, Runs]
"""With the batch and without it, (seeds, scenes) each."""


def kinds(strata: Sequence[str], solved: Both) -> tuple[tuple[WorthPart, ...], Retrained]:
    """What the batch changes over all scenes and on each kind of start; the first answer once more, whole.

    Args:
        strata: kind of start of each scene.
        solved: outcomes.
    """
    labels = np.asarray(strata)
    masks = {name: labels == name for name in dict.fromkeys(strata)}
    by_kind = {name: _of(solved, mask) for name, mask in masks.items()}
    overall = retrained(by_kind, {name: float(mask.mean()) for name, mask in masks.items()})
    found = {ALL: overall}
    if len(masks) > 1:
        found |= {name: retrained({name: pair}, {name: 1.0}) for name, pair in by_kind.items()}
    return _parts(found, {ALL: solved, **by_kind}), overall


def families(with_batch: Sequence[Played], without: Sequence[Played]) -> tuple[WorthPart, ...]:
    """How often scenes end in each failure family; a failure that comes later stands in another family."""
    names = sorted({f for played in (*with_batch, *without) for f in played.families if f})
    found: dict[str, Retrained] = {}
    counted: dict[str, Both] = {}
    for name in names:
        counted[name] = (_named(with_batch, name), _named(without, name))
        found[name] = retrained({name: counted[name]}, {name: 1.0})
    return _parts(found, counted)


def _parts(found: Mapping[str, Retrained], counted: Mapping[str, Both]) -> tuple[WorthPart, ...]:
    corrected = holm({name: r.p for name, r in found.items() if r.p is not None})
    return tuple(WorthPart(name=name, scenes=counted[name][0].shape[1], with_batch=_counts(counted[name][0]),
                           without=_counts(counted[name][1]), difference=r.estimate, low=r.low, high=r.high, p=r.p,
                           p_holm=corrected.get(name)) for name, r in found.items())


def ruled(parts: Sequence[WorthPart], overall: Retrained, seeds: int) -> tuple[str, str, int | None]:
    """Decision, its reason in one line, and how many more seeds a side would decide where it is INCONCLUSIVE.

    HURTS where a loss over all scenes is shown, or one on a kind of start that no gain over all scenes outweighs.
    HELPS where a gain is shown, over all scenes or on a kind of start, and no such loss.

    Args:
        parts: as `kinds` gives them.
        overall: its second answer.
        seeds: on the side that has fewer.
    """
    shown = {p.name: p for p in parts if p.p_holm is not None and p.p_holm <= ALPHA}
    gained = [n for n, p in shown.items() if p.difference > 0]
    lost = [n for n, p in shown.items() if p.difference < 0]
    told = f"{points(parts[0])}; fixed: {_listed(gained, shown)}; broken: {_listed(lost, shown)}"
    if seeds < LEAST_SEEDS:
        few = f"{seeds} seed{'s' * (seeds != 1)}, indicative"
        return "INCONCLUSIVE", f"{points(parts[0])} ({few}; {LEAST_SEEDS} on each side decide)", LEAST_SEEDS - seeds
    if ALL in lost or (lost and ALL not in gained):
        return "HURTS", told, None
    if gained:
        return "HELPS", told, None
    more = _more_seeds(overall, seeds)
    hint = "no number of seeds would decide on these scenes" if more is None else f"about {more} more seeds a side " \
                                                                                  "would decide at these rates"
    return "INCONCLUSIVE", f"{points(parts[0])}; no difference shown; {hint}", more


def points(part: WorthPart) -> str:
    """'+46.1 points [43.0 49.2]'."""
    interval = "" if part.low is None or part.high is None else f" [{100 * part.low:+.1f} {100 * part.high:+.1f}]"
    return f"{100 * part.difference:+.1f} points{interval}"


def _listed(names: Sequence[str], parts: Mapping[str, WorthPart]) -> str:
    """The kinds of start among these, with their points; 'none' where there is none."""
    return ", ".join(f"{n} {100 * parts[n].difference:+.1f}" for n in names if n != ALL) or "none"


def _more_seeds(overall: Retrained, seeds: int) -> int | None:
    """Seeds a side at which the difference seen would be shown with POWER; None where the scenes alone are too few.

    The error of the seeds falls with their number, that of the scenes does not.
    """
    wanted = (overall.estimate / (NormalDist().inv_cdf(1 - ALPHA / 2) + NormalDist().inv_cdf(POWER))) ** 2
    left = wanted - overall.scenes_error**2
    if left <= 0 or overall.seeds_error == 0:
        return None
    return max(1, ceil(seeds * overall.seeds_error**2 / left) - seeds)


def stacked(played: Sequence[Played]) -> Runs:
    """Outcomes of several seeds, shape (seeds, scenes)."""
    return np.stack([p.solved for p in played])


def _named(played: Sequence[Played], name: str) -> Runs:
    return np.array([[f == name for f in p.families] for p in played])


def _of(solved: Both, mask: NDArray[np.bool_]) -> Both:
    return solved[0][:, mask], solved[1][:, mask]


def _counts(runs: Runs) -> tuple[int, ...]:
    return tuple(map(int, runs.sum(axis=1)))
