"""Summary: the numbers of a run, out of its manifests."""

from typing import TYPE_CHECKING, Any

import numpy as np

from flows.run.steps_api import STAGES
from pipeline.statistics import compare, mcnemar, wilson
from schemas.summary import (
    AugmentReport,
    GateLine,
    Generation,
    Lap,
    LoopResult,
    Paired,
    ShadowLine,
    TriggerReport,
    WorthLine,
)
from schemas.verdict import Proportion

if TYPE_CHECKING:
    from flows.run.steps import Steps

KINDS = ("all", "common", "rare", "deployment_mix")


def proportions(result: dict[str, Any]) -> dict[str, Proportion]:
    """Kind of start or stratum -> success, from an exam's manifest."""
    return {k: Proportion.model_validate(v) for k, v in result["success"].items()}


def bits(result: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Scene by scene success of an exam, shape (scenes,)."""
    return np.array([b == "1" for b in result["bits"]])


def outputs(steps: "Steps", generation: int, stage: str) -> dict[str, Any] | None:
    """What a step says of itself; None where it is not finished."""
    step = steps.store.step(steps.run, generation, stage)
    return None if step is None else dict(step.outputs)


def examined(steps: "Steps") -> list[dict[str, Any]]:
    """Exam manifests of every finished lap, oldest first."""
    laps = (outputs(steps, g, "exam") for g in range(steps.recipe.generations + 1))
    return [lap for lap in laps if lap is not None]


def generations(steps: "Steps") -> tuple[Generation, ...]:
    """One line a finished lap."""
    lines: list[Generation] = []
    robot_s, asked = 0.0, 0
    for g, lap in enumerate(examined(steps)):
        verdict = steps.store.verdict(str(outputs(steps, g, "gate")["ids"][0]))  # type: ignore[index]
        success = proportions(lap["results"][lap["champion"]])
        lines.append(Generation(
            generation=g, dataset_version=str(outputs(steps, g, "build")["ids"][0]),  # type: ignore[index]
            policy=lap["champion"], success={k: success[k] for k in KINDS},
            gate=GateLine(verdict=verdict.decision, p=verdict.p), robot_s=round(robot_s, 2), corrections=asked,
            wall_s=wall(steps, g)))
        robot_s += steps.robot_seconds(g)
        asked += int((outputs(steps, g, "harvest") or {}).get("asked", 0))
    return tuple(lines)


def wall(steps: "Steps", generation: int) -> dict[str, float]:
    """Stage -> wall seconds of a lap."""
    done = {s: steps.store.step(steps.run, generation, s) for s in STAGES}
    return {s: round(step.wall_s, 3) for s, step in done.items() if step is not None}


def result(steps: "Steps") -> LoopResult:
    """The loop's result; wall time and memory are filled in by whoever measures them."""
    laps = examined(steps)
    if laps:
        first, last = (bits(lap["results"][lap["champion"]]) for lap in (laps[0], laps[-1]))
        pairs = compare(last, first)
        paired = Paired(fixed=pairs.fixed, broken=pairs.broken, p=mcnemar(pairs.fixed, pairs.broken).p_two_sided)
    else:
        paired = Paired(fixed=0, broken=0, p=1.0)
    return LoopResult(generations=generations(steps), control=generations(steps.control) if steps.control else None,
                      paired=paired, wall_s=0.0, peak_pss_mb=0.0, seed=steps.seed, twin=steps.twin,
                      shadow=_line(steps, "judge", "shadow", ShadowLine),
                      worth=_line(steps, "worth", "worth", WorthLine))


def _line[L: (ShadowLine, WorthLine)](steps: "Steps", stage: str, name: str, kind: type[L]) -> L | None:
    """What a stage after the last lap found; None where it found nothing, or did not run."""
    found = (outputs(steps, steps.recipe.generations, stage) or {}).get(name)
    return None if found is None else kind.model_validate(found)


def laps(steps: "Steps") -> tuple[Lap, ...]:
    """The numbers of each lap that only the report needs."""
    return tuple(_lap(steps, g, exam) for g, exam in enumerate(examined(steps)))


def _lap(steps: "Steps", g: int, exam: dict[str, Any]) -> Lap:
    augment, harvest = outputs(steps, g, "augment") or {}, outputs(steps, g, "harvest")
    champion, strata = exam["results"][exam["champion"]], proportions(exam["results"][exam["champion"]])
    cases = steps.store.hard_cases(run=steps.run, generation=g)
    tried = [c for c in cases if c.correction]
    version = steps.store.version(str(outputs(steps, g, "build")["ids"][0]))  # type: ignore[index]
    frames: dict[str, int] = {}
    for episode in steps.store.episodes(version.episodes):
        frames[episode.origin] = frames.get(episode.origin, 0) + episode.frames
    return Lap(
        generation=g,
        augment=AugmentReport.model_validate(augment["report"]) if augment.get("report") else None,
        triggers=_triggers(steps, g), exam_strata={k: v for k, v in strata.items() if k not in KINDS},
        candidate_exam=proportions(exam["results"][exam["candidate"]])["deployment_mix"],
        rewards={k: tuple(v) for k, v in champion["rewards"].items()},
        correction_success=wilson(sum(c.corrected for c in tried), len(tried)) if harvest and tried else None,
        frames_by_source=frames, shadow_disagreement=_disagreement(steps, g),
        signals=(outputs(steps, g, "deploy") or {}).get("signals", {}))


def _triggers(steps: "Steps", g: int) -> TriggerReport | None:
    deployed = outputs(steps, g, "deploy")
    if not deployed or not deployed["ids"]:
        return None
    episodes = steps.store.episodes([str(i) for i in deployed["ids"]])
    failed = np.array([b == "0" for b in deployed["truth"]])
    flagged = np.array([e.outcome.label == "failure" for e in episodes])
    both = int((failed & flagged).sum())
    names = [e.outcome for e in episodes if e.outcome.label == "failure"]
    return TriggerReport(
        precision=both / int(flagged.sum()) if flagged.any() else None,
        recall=both / int(failed.sum()) if failed.any() else None, flagged=int(flagged.sum()),
        failed=int(failed.sum()), by_trigger=_counts(str(o.trigger) for o in names),
        by_family=_counts(str(o.family) for o in names))


def _counts(names: Any) -> dict[str, int]:
    counted: dict[str, int] = {}
    for name in names:
        counted[name] = counted.get(name, 0) + 1
    return counted


def _disagreement(steps: "Steps", g: int) -> tuple[float, float] | None:
    deployed = outputs(steps, g, "deploy")
    if not deployed or not deployed["ids"] or any(d is None for d in deployed["disagreement"]):
        return None
    value = np.array(deployed["disagreement"], float)
    good = np.array([b == "1" for b in deployed["truth"]])
    if good.all() or not good.any():
        return None
    return float(value[good].mean()), float(value[~good].mean())
