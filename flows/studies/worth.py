"""Studies of what a batch is worth: real batches, poisoned ones, and halves chosen by a score or at random."""

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from flows.run.steps import Steps
from flows.run.worth import FOLDER, data_of, judge
from flows.run.worth_batch import of_lap
from flows.studies.measured import finished_loop, write_json
from flows.studies.poisons import DOSES, LAP, Dose, gated, poisoned
from flows.studies.selection import halves, scores
from pipeline.statistics.retraining import Retrained, retrained
from pipeline.store import Store
from pipeline.worth.judging import ALL, points, stacked
from pipeline.worth.scenes import worth_scenes
from pipeline.worth.trials import PROCESSES, Trial, run_trials
from pipeline.worth.without import without
from schemas.worth import BatchWorth, WorthPart
from stages.worth import SCENES, WITH, WITHOUT, worth

type Said = dict[str, Any]


def run_batches(*, seeds: int, recipe: str, json: Path | None, processes: int = PROCESSES) -> None:
    """Judge the first harvest of every finished loop by 8 + 8 trainings; beside it the exam, which no verdict reads."""
    _one_thread()
    found: list[Said] = []
    table = Table("seed", "verdict", "points", "fixed", "common", "rare", "exam: common", "exam: rare",
                  title="The first harvest, with it against without it; the exam is the twin's, one training seed each")
    for k in range(seeds):
        with finished_loop(recipe, k) as steps:
            batch = of_lap(steps, LAP)
            if batch is None:
                continue
            verdict = judge(steps.store, batch, processes=processes)
            said = {"seed": k, "worth": verdict.model_dump(mode="json"), "exam": _exam(steps)}
        found.append(said)
        by_name = {p.name: p for p in verdict.parts}
        table.add_row(str(k), verdict.decision, points(by_name[ALL]), _fixed(verdict),
                      *(f"{100 * v:+.1f}" for v in (*_sides(verdict.parts), *said["exam"])))
        Console(stderr=True).print(f"seed {k}: {verdict.decision} {verdict.reason}", highlight=False)
    Console().print(table)
    write_json(json, found)


def run_poisons(*, recipe: str, json: Path | None, processes: int = PROCESSES) -> None:
    """Poison the first harvest of one finished loop in known ways, and name the door that stops each."""
    _one_thread()
    found: list[Said] = []
    table = Table("poison", "of what", "share", "check", "worth of the batch", "worth of the corrections", "gate",
                  "stopped by")
    with finished_loop(recipe, 0) as steps:
        for dose in DOSES:
            said = _dose(steps, dose, processes)
            found.append(said)
            table.add_row(dose.poison, dose.scope, f"{dose.share:g}", said["check"][:30], said["whole"]["told"],
                          said.get("corrections", {}).get("told", ""), said["gate"], said["stopped by"])
            Console(stderr=True).print(f"{dose}: {said['stopped by']}", highlight=False)
    Console().print(table)
    write_json(json, found)


def run_selection(*, loops: int, seeds: int, recipe: str, json: Path | None, processes: int = PROCESSES) -> None:
    """Keep half of the first harvest by an influence score, at random, or the half that the score likes least."""
    _one_thread()
    ways: dict[str, list[Any]] = {}
    labels: list[list[str]] = []
    for k in range(loops):
        with finished_loop(recipe, k) as steps:
            batch = of_lap(steps, LAP)
            if batch is None:
                continue
            data = data_of(steps.store, batch)
            scored = scores(data, batch.version.episodes, steps.recipe, batch.rare, k)
            sides = {"all of it": (), **halves(batch.episodes, scored, k), "none of it": batch.episodes}
            played = worth_scenes(steps.recipe, batch.rare, SCENES, seed=k)
            labels.append([s.stratum for s in played])
            for way, out in sides.items():
                first = WITHOUT if way == "none of it" else WITH
                left = without(data, batch.version.episodes, out) if out else data
                done = run_trials([Trial(left, first + i) for i in range(seeds)], steps.recipe, played,
                                  keep=_folder(steps.store), processes=processes)
                ways.setdefault(way, []).append(stacked(done))
        Console(stderr=True).print(f"loop {k} finished", highlight=False)
    table = Table("kept", "success", "common", "rare", "against a random half, points", "p",
                  title=f"{loops} loops, {seeds} training seeds each, {SCENES} scenes a policy")
    told: dict[str, Said] = {}
    for way, runs in ways.items():
        against = None if way == "a random half" else _pooled(runs, ways["a random half"])
        told[way] = {"solved": [r.sum(1).tolist() for r in runs], "against": asdict(against) if against else None}
        table.add_row(way, f"{np.mean([r.mean() for r in runs]):.3f}", *_by_kind(runs, labels),
                      "" if against is None else _interval(against),
                      "" if against is None or against.p is None else f"{against.p:.2g}")
    Console().print(table)
    write_json(json, told)


def _dose(steps: Steps, dose: Dose, processes: int) -> Said:
    """One poisoned batch before every door."""
    bad, lap = poisoned(steps, dose, steps.seed), of_lap(steps, LAP)
    assert lap is not None, "the first lap of a finished loop has harvested"
    parts = {"whole": bad.batch}
    if dose.scope == "corrections":
        parts["corrections"] = bad.poisoned
    said: Said = {"poison": dose.poison, "scope": dose.scope, "share": dose.share, "check": bad.check}
    for name, episodes in parts.items():
        verdict = worth(bad.version, bad.data, episodes, bad.recipe, says=name, rare=lap.rare, seed=steps.seed,
                        keep=_folder(steps.store), processes=processes)
        said[name] = {"told": f"{verdict.decision} {points(verdict.parts[0])}",
                      "worth": verdict.model_dump(mode="json")}
    hurts = [name for name in parts if said[name]["told"].startswith("HURTS")]
    caught = "check" if bad.check != "passes" else "worth" if hurts else ""
    said["gate"] = gated(steps, bad)  # asked of all, since where no worth is asked it is the last door
    said["stopped by"] = caught or ("gate" if said["gate"] != "PASS" else "nothing")
    return said


def _fixed(verdict: BatchWorth) -> str:
    shown = [p for p in verdict.parts[1:] if p.p_holm is not None and p.p_holm <= 0.05]
    return ", ".join(f"{p.name} {100 * p.difference:+.0f}" for p in shown) or "none"


def _sides(parts: Sequence[WorthPart]) -> tuple[float, float]:
    """Difference on common starts, and on all others together."""
    rare = [p for p in parts if p.name not in (ALL, "common")]
    by_name = {p.name: p.difference for p in parts}
    scenes = max(sum(p.scenes for p in rare), 1)
    return by_name.get("common", by_name[ALL]), sum(p.difference * p.scenes for p in rare) / scenes


def _exam(steps: Steps) -> tuple[float, float]:
    """What the exam says of this lap's candidate against the one before, on common and on rare starts."""
    results = dict(steps.material.exams())
    new, old = (results[steps.candidate(g)] for g in (LAP, LAP - 1))
    kinds = np.array(new["strata"]) == "common"
    change = np.array([int(a) - int(b) for a, b in zip(new["bits"], old["bits"], strict=True)])
    return float(change[kinds].mean()), float(change[~kinds].mean())


def _pooled(first: Sequence[Any], second: Sequence[Any]) -> Retrained:
    """One way against another over all loops, each with an equal share; their seeds and scenes are their own."""
    share = 1 / len(first)
    return retrained({str(k): pair for k, pair in enumerate(zip(first, second, strict=True))},
                     {str(k): share for k in range(len(first))})


def _by_kind(runs: Sequence[Any], labels: Sequence[Sequence[str]]) -> tuple[str, str]:
    common = [np.array(kinds) == "common" for kinds in labels]
    return (f"{np.mean([r[:, c].mean() for r, c in zip(runs, common, strict=True)]):.3f}",
            f"{np.mean([r[:, ~c].mean() for r, c in zip(runs, common, strict=True)]):.3f}")


def _interval(r: Retrained) -> str:
    limits = "" if r.low is None or r.high is None else f" [{100 * r.low:+.1f} {100 * r.high:+.1f}]"
    return f"{100 * r.estimate:+.1f}{limits}"


def _folder(store: Store) -> Path:
    return store.root / FOLDER


def _one_thread() -> None:
    os.environ.setdefault("OMP_NUM_THREADS", "1")
