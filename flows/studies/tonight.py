"""`hardcase measure tonight`: the nightly gate on policies that real loops have trained, beside what the exam says."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from flows.run.steps import Steps
from flows.studies.counterfactual import measured
from flows.studies.measured import finished_loop, write_json
from pipeline.recipes import load_recipe
from pipeline.simulation.evaluation import evaluate
from pipeline.simulation.night_scenes import CANDIDATE, night_mix, night_scenes
from pipeline.statistics import wilson
from schemas.recipe import GateConfig
from schemas.scene import SceneSpec
from schemas.verdict import Verdict
from stages.nightly import judge_tonight

BETTER = 0.02
"""Change at the exam from which a policy is called better or worse, as in the study of loops."""
OTHER_NIGHT = 1000
"""Added to the lap for the night that asks the other way round: it plays scenes of its own."""


@dataclass(frozen=True, slots=True)
class Asked:
    """One night: a candidate, the champion that it met, and what the exam says of both."""

    seed: int
    generation: int
    way: str
    """'forward': the lap's candidate against the champion before it; 'back': the other way round."""
    decision: str
    scenes: int
    rates: tuple[float, float]
    """Success of candidate and champion on the night's scenes."""
    exam: tuple[float, float, float]
    """Candidate minus champion on the twin: estimate, low, high."""


def run_tonight_study(*, seeds: int, recipe: str, json: Path | None) -> dict[str, Any]:
    """Ask the nightly gate of every lap of every finished loop, both ways round, each night at the even stake.

    Args:
        seeds: finished loops.
        recipe: name or path of the loops' recipe; the gate is that of the recipe `nightly`.
        json: where to write every night.
    """
    gate, console, nights = load_recipe("nightly").gate, Console(stderr=True), list[Asked]()
    for k in range(seeds):
        with finished_loop(recipe, k) as steps:
            for generation in range(1, steps.recipe.generations + 1):
                for night in _both_ways(steps, generation, gate):
                    nights.append(night)
                    console.print(_line(night), highlight=False)
    found = {"nights": [asdict(n) for n in nights], "summary": summary(nights)}
    Console(width=120).print(table(found["summary"]))
    write_json(json, found)
    return found


def _both_ways(steps: Steps, generation: int, gate: GateConfig) -> list[Asked]:
    """The two nights of one lap; none where its candidate is the champion that it would meet."""
    new, old = steps.candidate(generation), steps.material.ids(generation - 1, "release")[0]
    if new == old:
        return []
    rare = sorted({c.stratum for c in steps.store.hard_cases(run=steps.run) if c.generation < generation} - {"common"})
    mix = night_mix(steps.recipe.task, rare, steps.recipe.gate.rare_share)
    return [_night(steps, generation, gate, mix, way, *pair)
            for way, pair in (("forward", (new, old)), ("back", (old, new)))]


def _night(steps: Steps, generation: int, gate: GateConfig, mix: dict[str, float], way: str, candidate: str,
           champion: str) -> Asked:
    recipe, night = steps.recipe, gate.nightly
    assert night is not None, "the recipe nightly has a nightly gate"
    policies = {p: steps.policy(p) for p in (candidate, champion)}

    def scenes(start: int, stop: int) -> list[SceneSpec]:
        return night_scenes(recipe.task, recipe.robot, recipe.scene, seed=steps.seed, sequence=CANDIDATE, start=start,
                            generation=generation + (OTHER_NIGHT if way == "back" else 0), stop=stop, mix=mix)

    verdict = judge_tonight(
        candidate, champion, generation=generation, families=tuple(mix), scenes=scenes, config=gate,
        stake=night.false_promotions * (1 - night.anchor_share) / night.nights,
        evaluate=lambda p, s: evaluate(policies[p], s, threads=1).success)
    was = measured(steps, champion, candidate)
    return Asked(steps.seed, generation, way, verdict.decision, verdict.scenes, _rates(verdict),
                 (was.estimate, was.low, was.high))


def _rates(verdict: Verdict) -> tuple[float, float]:
    whole = verdict.strata[0]
    return whole.candidate.rate, whole.champion.rate if whole.champion is not None else float("nan")


def summary(nights: Sequence[Asked]) -> list[dict[str, Any]]:
    """What became of candidates that are better, alike and worse by the exam."""
    kinds = {"better": [n for n in nights if n.exam[0] >= BETTER],
             "alike": [n for n in nights if abs(n.exam[0]) < BETTER],
             "worse": [n for n in nights if n.exam[0] <= -BETTER]}
    rows: list[dict[str, Any]] = []
    for kind, some in kinds.items():
        if not some:
            continue
        passed = sum(n.decision == "PASS" for n in some)
        share = wilson(passed, len(some))
        rows.append({"exam": kind, "nights": len(some), "promoted": passed, "low": share.low, "high": share.high,
                     "failed": sum(n.decision == "FAIL" for n in some),
                     "scenes": float(np.mean([n.scenes for n in some])),
                     "scenes_of_promotions": float(np.mean([n.scenes for n in some if n.decision == "PASS"] or [0])),
                     "points": 100 * float(np.mean([n.exam[0] for n in some]))})
    return rows


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """The summary for people."""
    shown = Table("by the exam", "nights", "mean change, points", "promoted", "FAIL", "scenes a night",
                  "scenes of a promotion", title=f"Better and worse: by {100 * BETTER:g} points or more on the twin")
    for row in rows:
        shown.add_row(row["exam"], str(row["nights"]), f"{row['points']:+.1f}",
                      f"{row['promoted']} [{row['low']:.2f} {row['high']:.2f}]", str(row["failed"]),
                      f"{row['scenes']:.0f}", f"{row['scenes_of_promotions']:.0f}" if row["promoted"] else "")
    return shown


def _line(n: Asked) -> str:
    return (f"seed {n.seed} lap {n.generation} {n.way}: {n.decision} after {n.scenes} scenes, "
            f"{n.rates[0]:.3f} against {n.rates[1]:.3f}; exam {100 * n.exam[0]:+.1f} [{100 * n.exam[1]:+.1f} "
            f"{100 * n.exam[2]:+.1f}]")
