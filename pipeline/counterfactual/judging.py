"""Judging: from a champion's recordings and any candidate to who was right at each lasting disagreement."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.counterfactual.branches import Branches, branch
from pipeline.counterfactual.moment import Beginning, Lab, moment_of
from pipeline.counterfactual.restore import faults
from pipeline.counterfactual.ride import Perceived, Restorable, Ride, ride
from pipeline.counterfactual.sampling import sample
from pipeline.counterfactual.windows import Window, first_window
from pipeline.disagreement import disagreement
from pipeline.files import short_id
from pipeline.protocols import Array
from pipeline.statistics import compare, wilson
from pipeline.statistics.paired import tango_upper
from pipeline.trace import Trace
from pipeline.triggers import stratum_of
from schemas.counterfactual import JudgeConfig, Judgement, Refusal, Side
from schemas.episode import Episode
from schemas.recipe import HarvestConfig
from schemas.scene import Draw

type Attempt = tuple[Episode, Trace]
type Seen = tuple[Episode, Perceived]
"""An attempt, as much of it as a policy is shown."""

ERROR = 0.025
"""Error of each limit of the interval of a gain."""


@dataclass(frozen=True, slots=True)
class Named:
    """A policy and its id."""

    id: str
    policy: Restorable


@dataclass(frozen=True, slots=True)
class Judged:
    """What came of a champion's attempts in the eyes of a candidate."""

    apart: tuple[Array, ...]
    """Disagreement at each tick of each attempt, shape (m,)."""
    windows: tuple[Window | None, ...]
    """The first lasting disagreement of each attempt."""
    judgements: tuple[Judgement, ...]
    weights: tuple[float, ...]
    """How many disagreements each judgement stands for; 1 where all were judged."""
    refusals: tuple[Refusal, ...]


@dataclass(frozen=True, slots=True)
class Case[L: Perceived]:
    """A disagreement that is to be judged."""

    episode: Episode
    log: L
    window: Window
    champion: Ride
    candidate: Ride


type Restore[L: Perceived] = Callable[[Sequence[Case[L]]], Sequence[Beginning | str]]
"""Cases -> for each the moment from which both go on, or why there is none."""


def judge(attempts: Sequence[Attempt], champion: Named, candidate: Named, draws: Sequence[Draw], lab: Lab,
          config: JudgeConfig, triggers: HarvestConfig) -> Judged:
    """Judge the first lasting disagreement of every attempt, or of a sample of those that have one.

    Args:
        attempts: of the champion, whole recordings of one task.
        champion, candidate: the candidate need not have ridden along.
        draws: physics of the robot that was recorded.
        lab: where moments are restored.
        config: what counts as a disagreement, how many draws.
        triggers: thresholds that were in force at work.
    """
    def restore(cases: Sequence[Case[Trace]]) -> Sequence[Beginning | str]:
        moments = [moment_of(c.episode, c.log, c.window, tuple(draws), c.champion, c.candidate) for c in cases]
        return [m if wrong is None else wrong for m, wrong in zip(moments, faults(moments, lab), strict=True)]

    return judge_by(restore, attempts, champion, candidate, lab, config, triggers)


def judge_by[L: Perceived](restore: Restore[L], attempts: Sequence[tuple[Episode, L]], champion: Named,
                           candidate: Named, lab: Lab, config: JudgeConfig, triggers: HarvestConfig) -> Judged:
    """Judge from whatever moments `restore` gives; see judge."""
    logs = [log for _, log in attempts]
    acted, would = ride(champion.policy, logs), ride(candidate.policy, logs)
    apart = tuple(disagreement(b.action, a.action) for a, b in zip(acted, would, strict=True))
    windows = tuple(first_window(d, config) for d in apart)
    cases: list[Case[L]] = []
    refused: list[Refusal] = []
    stands_for = sample(windows, config)
    for i in stands_for:
        (episode, log), window = attempts[i], windows[i]
        assert window is not None
        wrong = _another_policy(log, acted[i], champion.id)
        if wrong:
            refused.append(Refusal(episode=episode.id, tick=window.start, reason=wrong))
        else:
            cases.append(Case(episode, log, window, acted[i], would[i]))
    found = restore(cases)
    refused += [Refusal(episode=c.episode.id, tick=c.window.start, reason=wrong)
                for c, wrong in zip(cases, found, strict=True) if isinstance(wrong, str)]
    sound = [m for m in found if not isinstance(m, str)]
    played = branch(sound, champion.policy, candidate.policy, lab, config, triggers)
    made = [judgement(m, b, champion.id, candidate.id, config) for m, b in zip(sound, played, strict=True)]
    weights = {attempts[i][0].id: weight for i, weight in stands_for.items()}
    return Judged(apart, windows, tuple(made), tuple(weights[j.episode] for j in made), tuple(refused))


def gains_from_start(attempts: Sequence[Attempt], champion: Named, candidate: Named, draws: Sequence[Draw], lab: Lab,
                     config: JudgeConfig, triggers: HarvestConfig) -> Array:
    """Candidate's success minus the champion's, both alone from the first tick on; nothing is assumed here.

    Args:
        attempts: those that are judged; the number of draws is config.draws.
        champion, candidate, draws, lab, config, triggers: as for judge.

    Returns:
        One gain an attempt, shape (len(attempts),).
    """
    traces = [t for _, t in attempts]
    acted, would = (ride(named.policy, traces, ticks=1) for named in (champion, candidate))
    moments = [moment_of(e, t, Window(0, 1, 0.0), tuple(draws), a, b)
               for (e, t), a, b in zip(attempts, acted, would, strict=True)]
    played = branch(moments, champion.policy, candidate.policy, lab, config, triggers)
    return np.array([b.success[1].mean() - b.success[0].mean() for b in played])


def _another_policy(trace: Perceived, acted: Ride, champion: str) -> str | None:
    """Whether the champion, seeing what was recorded, does not do what was recorded."""
    differs = np.flatnonzero((trace.action != acted.action).any(axis=1))
    return f"policy {champion} does not give the recorded action of tick {differs[0]}" if differs.size else None


def judgement(moment: Beginning, branches: Branches, champion: str, candidate: str, config: JudgeConfig) -> Judgement:
    """Count the branches of one moment."""
    pairs, n = compare(branches.success[1], branches.success[0]), config.draws
    low, high = -tango_upper(pairs.fixed, pairs.broken, n, ERROR), tango_upper(pairs.broken, pairs.fixed, n, ERROR)
    return Judgement(
        id=short_id("judgement", moment.episode.id, moment.tick, champion, candidate, config.model_dump_json()),
        episode=moment.episode.id, tick=moment.tick, lasted=moment.window.stop - moment.window.start,
        disagreement=moment.window.disagreement, phase=moment.trace.phase[moment.tick],
        stratum=stratum_of(moment.trace.environment[0]), champion=_side(champion, branches, 0),
        candidate=_side(candidate, branches, 1), fixed=pairs.fixed, broken=pairs.broken,
        gain=(pairs.fixed - pairs.broken) / n, gain_low=low, gain_high=high)


def _side(policy: str, branches: Branches, row: int) -> Side:
    success, why = branches.success[row], Counter(name for name in branches.why[row] if name)
    return Side(policy=policy, success=wilson(int(success.sum()), len(success)), why=dict(sorted(why.items())))
