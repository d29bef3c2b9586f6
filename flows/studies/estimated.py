"""Estimated against exact: who was right by the sensors alone, beside who was right by the twin's own state."""

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from flows.run.judging import judged_at, sensed_at
from flows.run.steps import Steps
from flows.studies.measured import finished_loop, write_json
from pipeline.statistics import wilson
from schemas.counterfactual import JudgeConfig, Judgement, Right

ONE: tuple[Right, ...] = ("champion", "candidate")
"""Verdicts that say who of the two was right."""


@dataclass(frozen=True, slots=True)
class Case:
    """One disagreement, judged twice."""

    seed: int
    generation: int
    candidate: str
    episode: str
    tick: int
    phase: str
    stratum: str
    exact: str
    exact_decided: bool
    estimated: str | None
    """None where it was refused."""
    decided: bool
    gains: tuple[float, float]
    """Exact, estimated; NaN where it was refused."""
    error_rad: float
    error_m: float


def run_estimated_study(*, seeds: int, recipe: str, most: int, json: Path | None) -> dict[str, Any]:
    """Judge disagreements of finished loops by the twin's own state and by the sensors alone.

    Args:
        seeds: finished loops; the seed fixes the twin.
        recipe: name or path.
        most: disagreements judged of each pair, large ones more often.
        json: where to write all of it.
    """
    console, began, found = Console(stderr=True), time.process_time(), list[Case]()
    config, spent = JudgeConfig(most=most, checked=0), Counter[str]()
    for seed in range(seeds):
        with finished_loop(recipe, seed) as steps:
            for generation, candidate in opposites(steps):
                champion = str(steps.store.episode(steps.material.ids(generation, "deploy")[0]).policy)
                start = time.process_time()
                exact = judged_at(steps, generation, champion, candidate, config)[1]
                middle = time.process_time()
                told = sensed_at(steps, generation, champion, candidate, config)
                spent.update({"exact": middle - start, "estimated": time.process_time() - middle})
                known = {j.episode: j for j in told.judgements}
                found += [_case(seed, generation, candidate, j, known.get(j.episode)) for j in exact.judgements]
                console.print(f"seed {seed} lap {generation}: {_line(found)}")
    result = {"cases": [asdict(c) for c in found], "summary": summary(found), "cpu_s": {k: round(v) for k, v in
                                                                                       spent.items()},
              "all_cpu_s": round(time.process_time() - began)}
    Console(width=120).print(table(result["summary"]))
    write_json(json, result)
    return result


def opposites(steps: Steps) -> list[tuple[int, str]]:
    """Laps and candidates: the first champion's deployment in the eyes of the last champion, and the other way round.

    Policies that differ much are right or wrong often enough to count; so one of the two is in both directions.
    """
    laps = range(steps.recipe.generations)
    champions = [str(steps.store.episode(steps.material.ids(g, "deploy")[0]).policy) for g in laps]
    if champions[0] == champions[-1]:
        return []
    return [(0, champions[-1]), (champions.index(champions[-1]), champions[0])]


def _case(seed: int, generation: int, candidate: str, exact: Judgement, told: Judgement | None) -> Case:
    return Case(seed, generation, candidate, exact.episode, exact.tick, exact.phase, exact.stratum, exact.verdict,
                exact.decided, told.verdict if told else None, bool(told and told.decided),
                (exact.gain, told.gain if told else np.nan), told.replay_error_rad if told else np.nan,
                told.replay_error_m if told else np.nan)


def groups(cases: Sequence[Case]) -> Mapping[str, list[Case]]:
    """The cases that the exact verdict decided, in several ways."""
    decided = [c for c in cases if c.exact_decided]
    one = [c for c in decided if c.exact in ONE]
    return {
        "one of the two was right": one, "... and the estimate decided": [c for c in one if c.decided],
        "... from the first tick on": [c for c in one if c.tick == 0], "... later": [c for c in one if c.tick > 0],
        "both or neither was right": [c for c in decided if c.exact not in ONE], "all decided": decided,
        "... and the estimate decided too": [c for c in decided if c.decided],
    }


def summary(cases: Sequence[Case]) -> dict[str, Any]:
    """Agreement in each group, with what always saying 'both' would have got there; the worst seed; replay errors."""
    played = [c for c in cases if c.estimated is not None]
    rows = {name: _agreement(group) for name, group in groups(cases).items()}
    one = groups(cases)["one of the two was right"]
    by_seed = {seed: _agreement([c for c in one if c.seed == seed]) for seed in sorted({c.seed for c in one})}
    errors = np.array([(c.error_rad, c.error_m) for c in played if c.tick > 0]).reshape(-1, 2)
    return {
        "cases": len(cases), "refused": len(cases) - len(played), "groups": rows, "seeds": by_seed,
        "confusion": {f"{a} -> {b}": n for (a, b), n in
                      sorted(Counter((c.exact, str(c.estimated)) for c in cases if c.exact_decided).items())},
        "error_rad": np.quantile(errors[:, 0], (0.5, 0.9, 1.0)).tolist() if errors.size else [],
        "error_m": np.quantile(errors[:, 1], (0.5, 0.9, 1.0)).tolist() if errors.size else [],
    }


def _agreement(cases: Sequence[Case]) -> dict[str, Any]:
    """A refused case does not agree."""
    if not cases:
        return {"cases": 0}
    same = wilson(sum(c.exact == c.estimated for c in cases), len(cases))
    return {"cases": len(cases), "agree": same.successes, "rate": same.rate, "low": same.low, "high": same.high,
            "undecided": sum(not c.decided for c in cases), "always both": sum(c.exact == "both" for c in cases)}


def _line(cases: Sequence[Case]) -> str:
    rows = summary(cases)["groups"]
    return "; ".join(f"{name} {rows[name].get('agree', 0)} of {rows[name]['cases']}"
                     for name in ("one of the two was right", "all decided"))


def table(found: dict[str, Any]) -> Table:
    """Agreement as a table for a terminal."""
    shown = Table("exact verdict", "cases", "the estimate agrees", "95 %", "estimate undecided", "always 'both'",
                  title=f"{found['cases']} disagreements, {found['refused']} refused by the estimate")
    for name, r in found["groups"].items():
        if r["cases"]:
            shown.add_row(name, str(r["cases"]), f"{r['agree']} ({r['rate']:.3f})", f"[{r['low']:.3f} {r['high']:.3f}]",
                          str(r["undecided"]), str(r["always both"]))
    return shown
