"""Summary: from judgements to the shadow report: who was right where, what a promotion would change, what to do."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.counterfactual.change import Sampled, expected_change, mean_difference
from pipeline.counterfactual.judging import Judged, Seen
from pipeline.protocols import Array
from pipeline.statistics import Interval
from pipeline.triggers import stratum_of
from schemas.counterfactual import Change, FamilyRow, JudgeConfig, Judgement, Right, ShadowReport, ShadowRow

type Word = Literal["promote", "hold", "roll back"]


@dataclass(frozen=True, slots=True)
class Subject:
    """What a report is about."""

    run: str
    generation: int
    twin: int
    champion: str
    candidate: str
    former: bool
    """Whether the candidate has been champion before."""


@dataclass(frozen=True, slots=True)
class FromStart:
    """A random sample of the attempts, judged from their first tick."""

    attempts: Sequence[int]
    """Indices."""
    gains: Array


FROM_START_DRAWS = 2
"""Draws of an attempt that is played from its first tick: more attempts say more than more draws of one."""


def from_start[A](attempts: Sequence[A], config: JudgeConfig,
                  gains: Callable[[Sequence[A], JudgeConfig], Array]) -> FromStart | None:
    """Judge a random sample of the attempts from their first tick; None where none is to be checked.

    Args:
        attempts: all of them.
        config: how many are checked, and the seed that draws them.
        gains: (attempts, config with the draws of each) -> success of the candidate minus that of the champion.
    """
    n = min(config.checked, len(attempts))
    rng = np.random.default_rng([config.seed, 23])
    picked: list[int] = sorted(rng.choice(len(attempts), n, replace=False).tolist())
    if not picked:
        return None
    few = config.model_copy(update={"draws": FROM_START_DRAWS})
    return FromStart(picked, gains([attempts[i] for i in picked], few))


def summarize(subject: Subject, attempts: Sequence[Seen], judged: Judged, start: FromStart | None,
              config: JudgeConfig) -> ShadowReport:
    """Put everything together; the same judgements give the same report.

    Args:
        subject: which policies, where.
        attempts: all that were looked at.
        judged: what came of them.
        start: the check from the first tick, where it was made.
        config: what was asked for.
    """
    rng = np.random.default_rng([config.seed, 19])
    strata = [stratum_of(t.environment[0]) for _, t in attempts]
    gains = {j.episode: j for j in judged.judgements}
    weights = {j.episode: w for j, w in zip(judged.judgements, judged.weights, strict=True)}
    rows = [_row(name, [i for i, s in enumerate(strata) if name in ("all", s)], attempts, judged, gains, weights, rng)
            for name in ("all", *sorted(set(strata), key=lambda s: (s != "common", s)))]
    from_start, missed = _checked(start, attempts, judged, gains, rng)
    apart = np.concatenate(judged.apart)
    verdict, reason = decide(rows, missed, former=subject.former)
    return ShadowReport(
        run=subject.run, generation=subject.generation, twin=subject.twin, champion=subject.champion,
        candidate=subject.candidate, former=subject.former, ticks=apart.size,
        agreement=float((apart < config.threshold).mean()), rows=tuple(rows), families=families(judged.judgements),
        checked=len(start.attempts) if start else 0, from_start=from_start, missed=missed, verdict=verdict,
        reason=reason, config=config, judgements=judged.judgements, refusals=judged.refusals)


def _row(name: str, rows: Sequence[int], attempts: Sequence[Seen], judged: Judged,
         gains: dict[str, Judgement], weights: dict[str, float], rng: np.random.Generator) -> ShadowRow:
    found = [gains[attempts[i][0].id] for i in rows if attempts[i][0].id in gains]
    apart = sum(judged.windows[i] is not None for i in rows)
    known = bool(found) or not apart
    sampled = Sampled(len(rows), apart, [j.gain for j in found], [weights[j.episode] for j in found])
    change = expected_change(sampled, rng) if known else None
    counted: Counter[Right] = Counter(j.verdict for j in found)
    return ShadowRow(stratum=name, attempts=len(rows), apart=apart, judged=len(found), right=dict(counted),
                     undecided=sum(not j.decided for j in found), change=_change(change) if change else None)


def _checked(start: FromStart | None, attempts: Sequence[Seen], judged: Judged, gains: dict[str, Judgement],
             rng: np.random.Generator) -> tuple[Change | None, Change | None]:
    """The change from the start, and by how much the disagreements miss it in the same attempts."""
    if start is None or not len(start.attempts):
        return None, None
    whole = expected_change(Sampled(len(start.attempts), len(start.attempts), start.gains.tolist()), rng)
    both = [k for k, i in enumerate(start.attempts)
            if judged.windows[i] is None or attempts[i][0].id in gains]
    if not both:
        return _change(whole), None
    ids = [attempts[start.attempts[k]][0].id for k in both]
    at_windows = np.array([gains[id].gain if id in gains else 0.0 for id in ids])
    return _change(whole), _change(mean_difference(start.gains[both], at_windows, rng))


def _change(found: Interval) -> Change:
    return Change(estimate=found.estimate, low=found.low, high=found.high)


def families(judgements: Sequence[Judgement]) -> tuple[FamilyRow, ...]:
    """How often each policy was wrong for certain in each way, the most frequent way first."""
    counted: Counter[tuple[str, str]] = Counter()
    for j in judgements:
        if j.wrong in ("champion", "both"):
            counted[str(j.champion.main_reason), "champion"] += 1
        if j.wrong in ("candidate", "both"):
            counted[str(j.candidate.main_reason), "candidate"] += 1
    names = {name for name, _ in counted}
    rows = [FamilyRow(family=n, champion=counted[n, "champion"], candidate=counted[n, "candidate"]) for n in names]
    return tuple(sorted(rows, key=lambda r: (-r.champion - r.candidate, r.family)))


def decide(rows: Sequence[ShadowRow], missed: Change | None, *, former: bool) -> tuple[Word, str]:
    """Promote only for certain: the interval of the change lies above 0, no stratum loses for certain, and the
    check from the start does not contradict. To promote a former champion is to roll back.

    Returns:
        Verdict and its reason in a sentence.
    """
    change = rows[0].change
    if change is None:
        return "hold", "no disagreement could be judged"
    told = f"expected change {_points(change)} points"
    if change.high < 0:
        return "hold", f"the candidate is worse: {told}"
    if change.low <= 0:
        more = further_attempts(rows[0].attempts, change)
        return "hold", f"not sure: {told}" + (f"; some {more} more attempts would decide" if more else "")
    lost = [r for r in rows[1:] if r.change is not None and r.change.high < 0]
    if lost:
        return "hold", f"{told}, but starts of kind '{lost[0].stratum}' lose: {_points(lost[0].change)} points"
    if missed is not None and missed.high < 0:
        return "hold", f"{told}, but played from the start the candidate gains less: {_points(missed)} points"
    return ("roll back" if former else "promote"), f"the candidate is better: {told}"


def further_attempts(attempts: int, change: Change) -> int | None:
    """How many more attempts would move the interval off 0 if the estimate stayed; None where it is 0 itself."""
    if change.estimate == 0:
        return None
    half = (change.high - change.low) / 2
    return max(1, round(attempts * ((half / change.estimate) ** 2 - 1)))


def _points(change: Change | None) -> str:
    assert change is not None
    return f"{100 * change.estimate:+.1f} [{100 * change.low:+.1f} {100 * change.high:+.1f}]"


