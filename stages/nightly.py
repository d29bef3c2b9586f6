"""The nightly gate: candidate against champion on tonight's scenes, on a part of the year's error budget."""

from collections.abc import Callable, Mapping, Sequence
from math import exp, log
from types import MappingProxyType

import numpy as np

from pipeline.errors import GateError
from pipeline.statistics import compare, mcnemar, wilson
from pipeline.statistics.betting import log_bound, log_gain, loss_upper_by_bets
from pipeline.statistics.budget import given_back
from pipeline.statistics.nightly import Limits, Rulings, Tally, further_tonight, rule_nights
from pipeline.statistics.regression import chance_of_a_veto
from pipeline.trial import Evaluate, Progress, Scenes, Trial, outcomes
from schemas.recipe import GateConfig, NightlyConfig
from schemas.scene import SceneSpec
from schemas.verdict import Capital, Look, LostScene, NightTest, Regression, Selection, StratumResult, Verdict

type Again = Callable[[SceneSpec, int], Sequence[SceneSpec]]
"""(regression scene, times) -> the same start so many times, in simulation, each under a perception seed of its own."""

NO_NAMES: Mapping[int, str] = MappingProxyType({})


def judge_tonight(candidate: str, champion: str, *, generation: int, stake: float, families: Sequence[str],
                  scenes: Scenes, evaluate: Evaluate, config: GateConfig, regression: Sequence[SceneSpec] = (),
                  again: Again | None = None, named: Mapping[int, str] = NO_NAMES, selection: Selection | None = None,
                  progress: Progress | None = None) -> Verdict:
    """Judge a candidate tonight; PASS is wrong with probability `stake` at most, however soon it is said.

    After each batch: PASS where the bets against "no better on the mix" and against "this family loses the margin or
    more", for each family, have all reached 1 / stake; FAIL at a loss, which is tested tonight alone; INCONCLUSIVE
    where the scenes are spent or a PASS has become unlikely. Before a PASS the regression scenes are played: one that
    the champion always solves and the candidate hardly ever, twice, makes it a FAIL. They cannot make anything a PASS.

    Args:
        candidate, champion: policy ids.
        generation: of the candidate.
        stake: tonight's part of the budget, in (0, 0.5).
        families: strata of the mix, fixed before anything is played.
        scenes: (start, stop) -> scenes start..stop; each one's family is drawn from the mix, so that all are alike.
        evaluate: (policy id, scenes) -> solved or not, in their order.
        config: margin, alpha of FAIL, and `nightly`.
        regression: scenes that no release may lose.
        again: plays one of them several times.
        named: seed of a regression scene -> failure family, for the verdict's words.
        selection: how the candidate was chosen among its trainings, for the record.
        progress: told (scenes played, scenes at most) after each batch.

    Raises:
        GateError: no nightly gate is configured, the stake is outside (0, 0.5), a scene is of no family of the mix,
            of a twin, or played twice; regression scenes without a way to play them again.

    Source: docs/decisions/016-a-gate-for-every-night.md.
    """
    night = _checked(config, stake, regression, again)
    limits = Limits(config.margin, config.alpha, night.most_scenes)
    trial = Trial(candidate, champion, scenes, evaluate)
    while True:
        trial.play(len(trial.labels) + night.batch)
        if progress is not None:
            progress(len(trial.labels), night.most_scenes)
        tally = _tally(trial, champion, families)
        ruling = rule_nights(tally, np.array([stake]), limits)
        if ruling.passed[0] or ruling.failed[0] or ruling.given_up[0] or len(trial.labels) >= night.most_scenes:
            break
    vetoes = None
    if ruling.passed[0] and again is not None and regression:
        vetoes = _vetoes(trial, champion, evaluate, regression, again, night, named)
    return _verdict(trial, champion, generation, stake, tally, families, ruling, config, vetoes, selection)


def _checked(config: GateConfig, stake: float, regression: Sequence[SceneSpec], again: Again | None) -> NightlyConfig:
    """The nightly part of the config, or the reason why no night can begin."""
    if config.nightly is None:
        raise GateError("this recipe has no nightly gate", where="gate.nightly",
                        mend="add `nightly: {}` below `gate:` in the recipe, or use --recipe nightly")
    if not 0 < stake < 0.5:
        raise GateError(f"a stake of {stake:g} is no error that a night may make", where="tonight's stake",
                        mend="the budget of this year is spent, or gate.nightly.false_promotions is too large")
    if regression and again is None:
        raise GateError(f"{len(regression)} regression scenes and no way to play them", where="regression set",
                        mend="hand in `again`, which gives a scene several perception seeds")
    return config.nightly


def _tally(trial: Trial, champion: str, families: Sequence[str]) -> Tally:
    """Counts by family, in the order of `families`."""
    labels = np.asarray(trial.labels)
    if strange := sorted(set(trial.labels) - set(families)):
        raise GateError(f"a scene of {strange[0]!r}, which is no family of tonight's mix", where="gate scenes",
                        mend=f"draw scenes from the families that were fixed beforehand: {', '.join(families)}")
    new, old = trial.solved[trial.candidate], trial.solved[champion]
    fixed, broken, scenes = (np.array([[int(part[labels == name].sum()) for name in families]])
                             for part in (new & ~old, old & ~new, np.ones_like(new)))
    return Tally(fixed, broken, scenes)


def _vetoes(trial: Trial, champion: str, evaluate: Evaluate, regression: Sequence[SceneSpec], again: Again,
            night: NightlyConfig, named: Mapping[int, str]) -> Regression:
    """The regression scenes that the candidate loses twice: what seems lost is played once more, under other seeds."""
    seeds, where = night.regression_seeds, "regression scenes"
    copies = [tuple(again(scene, 2 * seeds)) for scene in regression]
    if wrong := [c for c in copies if len(c) != 2 * seeds or any(s.twin is not None for s in c)]:
        raise GateError(f"a regression scene gave {len(wrong[0])} starts instead of {2 * seeds} in simulation",
                        where=where, mend="`again` gives the same start so many times, none of them on a twin")

    def solved(policy: str, rows: Sequence[int], part: slice) -> dict[int, int]:
        asked = [s for k in rows for s in copies[k][part]]
        found = outcomes(evaluate, policy, asked, where) if asked else np.zeros(0, np.bool_)
        return {k: int(found[i * seeds:(i + 1) * seeds].sum()) for i, k in enumerate(rows)}

    rows, new, old = list(range(len(copies))), [0] * len(copies), [0] * len(copies)
    for part in (slice(0, seeds), slice(seeds, 2 * seeds)):
        candidates = solved(trial.candidate, rows, part)
        rows = [k for k in rows if candidates[k] <= night.regression_lost]
        champions = solved(champion, rows, part)
        rows = [k for k in rows if champions[k] == seeds]
        for k in rows:
            new[k], old[k] = new[k] + candidates[k], old[k] + champions[k]
    lost = tuple(LostScene(seed=regression[k].seed, stratum=regression[k].stratum, candidate=new[k], champion=old[k],
                           family=named.get(regression[k].seed, "")) for k in rows)
    return Regression(scenes=len(copies), seeds=seeds, at_most=night.regression_lost, lost=lost,
                      chance=chance_of_a_veto(len(copies), seeds, night.regression_lost))


def _verdict(trial: Trial, champion: str, generation: int, stake: float, tally: Tally, families: Sequence[str],
             ruling: Rulings, config: GateConfig, vetoes: Regression | None, selection: Selection | None) -> Verdict:
    """Write down where the night ended."""
    capitals = _capitals(tally, families, config.margin)
    strata = _strata(trial, champion, families, stake)
    passed = bool(ruling.passed[0]) and not (vetoes and vetoes.lost)
    decision = "PASS" if passed else "FAIL" if ruling.failed[0] or ruling.passed[0] else "INCONCLUSIVE"
    more = further_tonight(tally, stake, config.margin) if decision == "INCONCLUSIVE" else None
    least = exp(min(700.0, *(c.log_capital for c in capitals)))
    tonight = NightTest(stake=stake, capitals=capitals, alpha_fail=config.alpha, regression=vetoes,
                        given_back=float(given_back(stake, passed, least)), selection=selection)
    reason = _reason(decision, strata, tonight, bool(ruling.given_up[0]), config.margin, more)
    return Verdict(
        id=trial.verdict_id(generation, config.model_dump_json(), repr(stake), *families), candidate=trial.candidate,
        champion=champion, generation=generation, decision=decision, reason=reason, strata=strata,
        looks=(Look(scenes=len(trial.labels), alpha=stake, decision="continue" if more or decision == "INCONCLUSIVE"
                    else decision),),
        p=min(1.0, exp(-capitals[0].log_capital)), scenes=len(trial.labels), margin=config.margin, more_scenes=more,
        tonight=tonight)


def _capitals(tally: Tally, families: Sequence[str], margin: float) -> tuple[Capital, ...]:
    """What the bets against every claim have come to."""
    fixed, broken, n = (x[0] for x in (tally.fixed, tally.broken, tally.scenes))
    whole = Capital(claim="no better", stratum="all", scenes=int(n.sum()), fixed=int(fixed.sum()),
                    broken=int(broken.sum()), log_capital=float(log_gain(int(fixed.sum()), int(broken.sum()))))
    return whole, *(Capital(claim="loses the margin", stratum=name, scenes=int(n[k]), fixed=int(fixed[k]),
                            broken=int(broken[k]), log_capital=float(log_bound(fixed[k], broken[k], n[k], margin)))
                    for k, name in enumerate(families))


def _strata(trial: Trial, champion: str, families: Sequence[str], stake: float) -> tuple[StratumResult, ...]:
    """The whole mix and every family; p values as McNemar gives them, bounds true at all moments together."""
    labels, found = np.asarray(trial.labels), list[StratumResult]()
    for name in ("all", *families):
        mask = np.ones(labels.size, np.bool_) if name == "all" else labels == name
        pairs = compare(trial.solved[trial.candidate][mask], trial.solved[champion][mask])
        test = mcnemar(pairs.fixed, pairs.broken)
        found.append(StratumResult(
            stratum=name, candidate=wilson(pairs.candidate, pairs.n), champion=wilson(pairs.champion, pairs.n),
            fixed=pairs.fixed, broken=pairs.broken, p_gain=test.p_gain, p_loss=test.p_loss,
            loss_upper=loss_upper_by_bets(pairs.fixed, pairs.broken, pairs.n, stake)))
    return tuple(found)


def _reason(decision: str, strata: Sequence[StratumResult], tonight: NightTest, given_up: bool, margin: float,
            more: int | None) -> str:
    """Why, in words and numbers."""
    whole = strata[0]
    seen = f"{whole.fixed} fixed, {whole.broken} broken of {whole.candidate.n}"
    short = [c for c in tonight.capitals if c.log_capital < -log(tonight.stake)]
    if decision == "PASS":
        return f"gain of {seen}; every family loses less than {margin:.1%}; wrong with {tonight.stake:.2g} at most"
    if decision == "FAIL" and tonight.regression and tonight.regression.lost:
        names = ", ".join(f"{s.family} {s.stratum} {s.seed}".strip() for s in tonight.regression.lost[:5])
        return (f"veto: loses {len(tonight.regression.lost)} of {tonight.regression.scenes} regression scenes that the "
                f"champion always solves: {names}")
    if decision == "FAIL":
        return f"loss: {seen}, in " + ", ".join(f"{s.stratum} {s.fixed} to {s.broken}" for s in strata[1:])
    parts = [f"no gain shown, {seen}" if short[0].claim == "no better" else f"gain of {seen}"]
    parts += [f"loss in {c.stratum} not bounded below {margin:.1%}: {c.broken} broken, {c.fixed} fixed of {c.scenes}"
              for c in short if c.claim != "no better"]
    parts += ["stopped early: a promotion has become unlikely tonight"] if given_up else []
    parts.append("the outcomes seen point to no number of scenes that would promote" if more is None
                 else f"about {more} more scenes would promote at these rates")
    return "; ".join(parts)
