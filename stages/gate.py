"""The gate: candidate against champion on the same simulated scenes, look by look, until a decision stands."""

from collections.abc import Sequence

import numpy as np

from pipeline.errors import GateError
from pipeline.statistics import spend, wilson
from pipeline.statistics.promotion import Ruling, compare_strata, further_scenes, out_of_reach, rule
from pipeline.trial import Evaluate, Progress, Scenes, Trial
from schemas.recipe import GateConfig
from schemas.verdict import Look, StratumResult, Verdict


def gate(candidate: str, champion: str | None, *, generation: int, scenes: Scenes, evaluate: Evaluate,
         config: GateConfig, progress: Progress | None = None) -> Verdict:
    """Judge a candidate policy; only PASS and BOOTSTRAP may be released.

    Both policies play the same scenes. After each look of config.looks: FAIL at a significant loss anywhere; PASS at
    a significant gain overall or in a stratum, if in every stratum the upper bound of the loss is below
    config.margin; else more scenes, until the budget ends or more cannot help: INCONCLUSIVE. Without a champion,
    BOOTSTRAP where the lower Wilson bound of success reaches config.bootstrap_success, else FAIL.
    The verdict is a function of the outcomes alone.

    Args:
        candidate: policy id.
        champion: policy id of the champion, None before the first release.
        generation: of the candidate.
        scenes: (start, stop) -> scenes start..stop of one fixed sequence of gate scenes.
        evaluate: (policy id, scenes) -> solved or not, shape (len(scenes),), in their order.
        config: looks, alpha, margin and bootstrap threshold.
        progress: told (scenes played, scenes at most) after each look.

    Raises:
        GateError: scenes are missing, repeated, or not of the gate's own family; outcomes do not fit the scenes.

    Source: docs/decisions/006-gate.md.
    """
    trial = Trial(candidate, champion, scenes, evaluate)
    budget = config.looks[-1] if champion is not None else config.looks[0]
    alphas = spend(config.looks, config.alpha)
    looks: list[Look] = []
    for index, (stop, alpha) in enumerate(zip(config.looks, alphas, strict=True)):
        trial.play(stop)
        if progress is not None:
            progress(stop, budget)
        if champion is None:
            return _bootstrap(trial, generation, config)
        strata = compare_strata(trial.labels, trial.solved[candidate], trial.solved[champion], alpha)
        ruling = rule(strata, config, index)
        decision = ruling.decision if ruling.decision in ("PASS", "FAIL") else "continue"
        looks.append(Look(scenes=stop, alpha=alpha, decision=decision))
        if ruling.decision != "continue" or stop == budget:
            return _verdict(trial, generation, config, strata, tuple(looks), ruling)
    raise GateError("no look is planned", where="gate.looks", mend="give gate.looks at least one scene count")


def _bootstrap(trial: Trial, generation: int, config: GateConfig) -> Verdict:
    """Judge a candidate that has no champion to be compared with."""
    labels, solved = np.asarray(trial.labels), trial.solved[trial.candidate]
    groups = {"all": np.ones(labels.size, np.bool_)} | {s: labels == s for s in sorted(set(trial.labels))}
    strata = tuple(StratumResult(stratum=name, candidate=wilson(int(solved[mask].sum()), int(mask.sum())),
                                 fixed=0, broken=0, p_gain=None, p_loss=None, loss_upper=None)
                   for name, mask in groups.items())
    asked = next((s for s in strata if s.stratum == "common"), strata[0])
    good = asked.candidate.low >= config.bootstrap_success
    reason = (f"no champion yet; {asked.stratum}: {asked.candidate.successes} of {asked.candidate.n} solved, lower "
              f"bound {asked.candidate.low:.1%} {'reaches' if good else 'is below'} {config.bootstrap_success:.1%}")
    return Verdict(id=trial.verdict_id(generation, config.model_dump_json()), candidate=trial.candidate, champion=None,
                   generation=generation, decision="BOOTSTRAP" if good else "FAIL", reason=reason, strata=strata,
                   p=None, scenes=len(trial.labels), margin=config.margin, more_scenes=None)


def _verdict(trial: Trial, generation: int, config: GateConfig, strata: tuple[StratumResult, ...],
             looks: tuple[Look, ...], ruling: Ruling) -> Verdict:
    """Write down the last look."""
    by_name = {s.stratum: s for s in strata}
    more: int | None = None
    if ruling.decision == "FAIL":
        decision, reason = "FAIL", f"loss {_named(ruling.lost, by_name)}, corrected p {ruling.p_loss:.2g}"
    elif ruling.decision == "PASS":
        decision = "PASS"
        reason = (f"gain {_named(ruling.gained, by_name)}, corrected p {ruling.p_gain:.2g}; "
                  f"no stratum loses {config.margin:.1%} or more")
    else:
        decision, more = "INCONCLUSIVE", further_scenes(strata, config, len(looks) - 1)
        reason = _doubt(by_name, ruling, config, len(looks) - 1, more)
    return Verdict(id=trial.verdict_id(generation, config.model_dump_json()), candidate=trial.candidate,
                   champion=trial.champion, generation=generation, decision=decision, reason=reason, strata=strata,
                   looks=looks, p=ruling.p_gain, scenes=len(trial.labels), margin=config.margin, more_scenes=more)


def _named(names: Sequence[str], strata: dict[str, StratumResult]) -> str:
    """'in side (40 fixed, 1 broken of 60), ...'."""
    rows = (f"{s.stratum} ({s.fixed} fixed, {s.broken} broken of {s.candidate.n})" for s in map(strata.get, names) if s)
    return "in " + ", ".join(rows)


def _doubt(strata: dict[str, StratumResult], ruling: Ruling, config: GateConfig, look: int, more: int | None) -> str:
    """Why there is no answer, and what would give one."""
    parts = [f"gain shown {_named(ruling.gained, strata)}" if ruling.gained else
             f"no gain shown, corrected p {ruling.p_gain:.2g}"]
    parts += [f"loss in {name} not bounded below {config.margin:.1%}: {strata[name].broken} broken, "
              f"{strata[name].fixed} fixed of {strata[name].candidate.n}, upper bound {strata[name].loss_upper:.1%}"
              for name in ruling.unbounded]
    if ruling.decision == "stop":
        small = out_of_reach(tuple(strata.values()), config, look)
        parts.append(f"stopped early: {', '.join(small)} gets too few scenes within the budget, raise gate.looks or "
                     "gate.rare_share" if small else "stopped early: a gain has become unlikely within the budget")
    parts.append("the outcomes seen point to no number of scenes that would decide" if more is None
                 else f"about {more} more scenes would decide at these rates")
    return "; ".join(parts)
