"""The promotion rule: what paired outcomes at one look say about letting a candidate replace the champion.

Three questions, each answered wrongly with probability alpha at most over all looks together:
is there a gain somewhere (else no PASS), is there a loss somewhere (then FAIL), and is the loss of every stratum
bounded below the margin (else no PASS). See docs/decisions/006-gate.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, sqrt
from typing import Literal

import numpy as np

from pipeline.statistics.paired import Outcomes, compare, loss_upper, mcnemar, score
from pipeline.statistics.proportions import wilson
from pipeline.statistics.sequential import (
    further_scenes_to_bound,
    further_scenes_to_show,
    holm,
    outlook,
    spend,
)
from schemas.recipe import GateConfig
from schemas.verdict import StratumResult

FUTILE = 0.1
"""A gain less likely than this to become significant is not waited for; measured in tests/bench_gate.py."""


@dataclass(frozen=True, slots=True)
class Ruling:
    """What one look says; p values are corrected for strata and looks, so they compare to alpha itself."""

    decision: Literal["PASS", "FAIL", "continue", "stop"]
    gained: tuple[str, ...]
    """Names with a significant gain ('all' or strata)."""
    lost: tuple[str, ...]
    """Names with a significant loss."""
    unbounded: tuple[str, ...]
    """Strata whose loss is not yet bounded below the margin."""
    p_gain: float
    """Smallest corrected p of a gain."""
    p_loss: float
    """Smallest corrected p of a loss."""


def compare_strata(labels: Sequence[str], candidate: Outcomes, champion: Outcomes,
                   alpha: float) -> tuple[StratumResult, ...]:
    """Candidate against champion, 'all' first, then every stratum by name.

    Args:
        labels: stratum of each scene, length n.
        candidate: solved or not, shape (n,).
        champion: the same scenes, shape (n,).
        alpha: error of each loss bound.
    """
    names = np.asarray(labels)
    groups = {"all": np.ones(len(labels), np.bool_)} | {str(s): names == s for s in sorted(set(labels))}
    return tuple(_one(name, candidate[mask], champion[mask], alpha) for name, mask in groups.items())


def rule(strata: Sequence[StratumResult], config: GateConfig, look: int) -> Ruling:
    """Decide at look number `look` (from 0) from the results of compare_strata at that look's alpha.

    A significant loss anywhere is FAIL. A significant gain anywhere, with the loss of every stratum bounded below
    the margin, is PASS. "stop" gives up before the budget is spent, where futile() or out_of_reach() see no prospect of
    a PASS; that can only lower the chance of a promotion. Else "continue", also at the last look, where the caller
    has to end.

    Source: intersection-union argument for "every stratum", Berger 1982, Technometrics 24:295; Holm 1979 for
    "anywhere"; union bound over looks, see sequential.spend.
    """
    alphas = spend(config.looks, config.alpha)
    questions = hypotheses(strata)
    scale = config.alpha / alphas[look]
    gains = {s: min(1.0, p * scale) for s, p in holm({s.stratum: s.p_gain or 0.0 for s in questions}).items()}
    losses = {s: min(1.0, p * scale) for s, p in holm({s.stratum: s.p_loss or 0.0 for s in questions}).items()}
    gained = tuple(s for s, p in gains.items() if p <= config.alpha)
    lost = tuple(s for s, p in losses.items() if p <= config.alpha)
    unbounded = tuple(s.stratum for s in strata[1:] if s.loss_upper is None or s.loss_upper >= config.margin)
    decision: Literal["PASS", "FAIL", "continue", "stop"] = "continue"
    if lost:
        decision = "FAIL"
    elif gained and not unbounded:
        decision = "PASS"
    elif look + 1 < len(alphas) and (
            (not gained and futile(strata, config, look)) or out_of_reach(strata, config, look)):
        decision = "stop"
    return Ruling(decision, gained, lost, unbounded, min(gains.values()), min(losses.values()))


def hypotheses(strata: Sequence[StratumResult]) -> Sequence[StratumResult]:
    """The questions asked at once: overall and every stratum; a single stratum is the overall."""
    return strata if len(strata) > 2 else strata[:1]


def futile(strata: Sequence[StratumResult], config: GateConfig, look: int) -> bool:
    """Whether no gain is likely to become significant by the last look; without a discordant scene, none is."""
    questions = hypotheses(strata)
    level = spend(config.looks, config.alpha)[-1] / len(questions)
    seen = config.looks[look] / config.looks[-1]
    return all(s.fixed + s.broken == 0 or outlook(
        (s.fixed - s.broken) / sqrt(s.fixed + s.broken), seen, level) < FUTILE for s in questions)


def out_of_reach(strata: Sequence[StratumResult], config: GateConfig, look: int) -> tuple[str, ...]:
    """Strata whose loss is unlikely to be bounded below the margin by the last look.

    Either a chance below FUTILE at the trend seen, or too few scenes: even if none of the scenes to come were
    broken, and as many fixed as before, no later look would bound the loss.
    """
    alphas = spend(config.looks, config.alpha)

    def reachable(s: StratumResult) -> bool:
        z = -float(score(s.broken, s.fixed, s.candidate.n, config.margin))
        if outlook(z, config.looks[look] / config.looks[-1], alphas[-1]) < FUTILE:
            return False
        for later, alpha in zip(config.looks[look + 1:], alphas[look + 1:], strict=True):
            growth = later / config.looks[look]  # strata keep their share of the scenes
            if loss_upper(int(s.fixed * growth), s.broken, ceil(s.candidate.n * growth), alpha) < config.margin:
                return True
        return False

    return tuple(s.stratum for s in strata[1:] if not reachable(s))


def further_scenes(strata: Sequence[StratumResult], config: GateConfig, look: int) -> int | None:
    """Further scenes of the gate's mix that would decide at the rates seen so far; None where none would.

    The gain needs its best question answered and the loss every stratum bounded; where a stratum loses the margin
    or more, or nothing gains, it is the scenes that would prove a loss.
    """
    alpha = spend(config.looks, config.alpha)[look]
    total = strata[0].candidate.n
    questions = hypotheses(strata)
    share = {s.stratum: total / s.candidate.n for s in strata}

    def scaled(s: StratumResult, scenes: int | None) -> float:
        return float("inf") if scenes is None else scenes * share[s.stratum]

    level = alpha / len(questions)
    gain = min(0.0 if (s.p_gain or 0.0) <= level else scaled(s, further_scenes_to_show(
        s.fixed, s.broken, s.candidate.n, level)) for s in questions)
    bound = max(0.0 if s.loss_upper is not None and s.loss_upper < config.margin else scaled(
        s, further_scenes_to_bound(s.fixed, s.broken, s.candidate.n, alpha, config.margin)) for s in strata[1:])
    loss = min(scaled(s, further_scenes_to_show(s.broken, s.fixed, s.candidate.n, level)) for s in questions)
    scenes = min(max(gain, bound), loss)
    return None if scenes == float("inf") else int(-(-scenes // 1))


def _one(name: str, candidate: Outcomes, champion: Outcomes, alpha: float) -> StratumResult:
    """One row of the verdict."""
    pairs = compare(candidate, champion)
    test = mcnemar(pairs.fixed, pairs.broken)
    return StratumResult(stratum=name, candidate=wilson(pairs.candidate, pairs.n),
                         champion=wilson(pairs.champion, pairs.n), fixed=pairs.fixed, broken=pairs.broken,
                         p_gain=test.p_gain, p_loss=test.p_loss,
                         loss_upper=loss_upper(pairs.fixed, pairs.broken, pairs.n, alpha))
