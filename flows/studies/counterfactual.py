"""Calibration: the change that judged disagreements foretell against the change that paired evaluation measures."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from flows.run.judging import judged_at
from flows.run.material import Material
from flows.run.steps import Steps
from flows.studies.measured import finished_loop
from pipeline.files import atomic
from pipeline.report.alone import alone
from pipeline.report.charts import Axis, Line, scatter_chart
from pipeline.simulation.tasks import load_task
from pipeline.statistics import Interval, bootstrap_difference, predict_quality
from schemas.counterfactual import Change, JudgeConfig

ESTIMATES = ("disagreements", "start")


@dataclass(frozen=True, slots=True)
class Pair:
    """One champion and one candidate: what was foretold, and what was measured."""

    seed: int
    generation: int
    champion: str
    candidate: str
    windows: int
    judged: int
    refused: int
    disagreements: tuple[float, float, float]
    """Estimate, low, high."""
    start: tuple[float, float, float]
    missed: tuple[float, float, float]
    measured: tuple[float, float, float]
    verdict: str
    right: dict[str, int]


def measure_counterfactual(*, seeds: int, recipe: str, pairs: int, draws: int,
                           say: Callable[[str], None]) -> dict[str, Any]:
    """Judge `pairs` pairs of policies of every seed, and hold each against the exam, on the same fresh starts.

    Args:
        seeds: finished loops; the seed fixes the twin.
        recipe: name or path.
        pairs: drawn at random from deployed champions and all other policies of the seed's store, arms included.
        draws: of each policy at each disagreement.
        say: told a line after every pair.
    """
    found: list[Pair] = []
    for seed in range(seeds):
        with finished_loop(recipe, seed) as steps:
            for generation, candidate in pairs_of(steps, pairs):
                found.append(_pair(steps, seed, generation, candidate, draws))
                say(_line(found[-1]))
    return {"pairs": [asdict(p) for p in found], "summary": {n: calibration(found, n) for n in ESTIMATES}}


def pairs_of(steps: Steps, count: int) -> list[tuple[int, str]]:
    """Laps whose deployment is judged and candidates, drawn at random without repetition."""
    champions: dict[str, int] = {}
    for g in range(steps.recipe.generations):
        champions.setdefault(steps.store.episode(steps.material.ids(g, "deploy")[0]).policy or "", g)
    policies = sorted(exams(steps))
    every = [(g, p) for champion, g in champions.items() for p in policies if p != champion]
    rng = np.random.default_rng([43, steps.seed])
    return [every[k] for k in sorted(rng.choice(len(every), min(count, len(every)), replace=False).tolist())]


def _pair(steps: Steps, seed: int, generation: int, candidate: str, draws: int) -> Pair:
    champion = str(steps.store.episode(steps.material.ids(generation, "deploy")[0]).policy)
    report = judged_at(steps, generation, champion, candidate, JudgeConfig(draws=draws))[1]
    row, was = report.rows[0], measured(steps, champion, candidate)
    return Pair(seed, generation, champion, candidate, row.apart, row.judged, len(report.refusals),
                _three(report.change), _three(report.from_start), _three(report.missed),
                (was.estimate, was.low, was.high), report.verdict, {str(k): v for k, v in row.right.items()})


def measured(steps: Steps, champion: str, candidate: str) -> Interval:
    """Candidate minus champion at the exam: the same fresh starts of the twin, weighted to the mix of deployment."""
    known = exams(steps)
    strata = np.array(known[champion]["strata"])
    bits = [np.array([b == "1" for b in known[p]["bits"]]) for p in (candidate, champion)]
    task, share = load_task(steps.recipe.task), steps.recipe.deploy.rare_share
    shares = {n: (1 - share) / len(task.common) for n in task.common} | {n: share * s for n, s in task.rare.items()}
    split = {n: (bits[0][None, strata == n], bits[1][None, strata == n]) for n in shares}
    return bootstrap_difference(split, shares, np.random.default_rng(53))


def exams(steps: Steps) -> dict[str, dict[str, Any]]:
    """Policy -> its exam, of every arm in this store: all of them sat the same one."""
    return {policy: result for run in steps.store.runs() for policy, result in Material(steps.store, run).exams()}


def _three(change: Change | None) -> tuple[float, float, float]:
    return (change.estimate, change.low, change.high) if change else (np.nan, np.nan, np.nan)


def calibration(pairs: list[Pair], name: str) -> dict[str, Any]:
    """How well one estimate foretells the measured change.

    `covered` counts intervals that hold the measured change as it was measured; `covered_with_error` those where the
    distance is below the root of both half widths' squares, since the measurement has an error of its own.
    """
    told = np.array([getattr(p, name) for p in pairs])
    was = np.array([p.measured for p in pairs])
    error = told[:, 0] - was[:, 0]
    half = np.where(error[:, None] > 0, told[:, 0:1] - told[:, 1:2], told[:, 2:3] - told[:, 0:1])[:, 0]
    noise = np.where(error > 0, was[:, 2] - was[:, 0], was[:, 0] - was[:, 1])
    quality = predict_quality(told[:, 0].tolist(), was[:, 0].tolist())
    clear = (np.abs(was[:, 0]) > 0.02) & (np.abs(told[:, 0]) > 0.02)
    return {
        "pairs": len(pairs), "covered": int(((was[:, 0] >= told[:, 1]) & (was[:, 0] <= told[:, 2])).sum()),
        "covered_with_error": int((np.abs(error) <= np.hypot(half, noise)).sum()), "bias": float(error.mean()),
        "rmse": float(np.sqrt((error ** 2).mean())), "half_width": float((told[:, 2] - told[:, 1]).mean() / 2),
        "clear": int(clear.sum()), "clear_with_the_same_sign": int((told[clear, 0] * was[clear, 0] > 0).sum()),
        **asdict(quality),
    }


def _line(p: Pair) -> str:
    told, was = _percent(p.disagreements), _percent(p.measured)
    return f"seed {p.seed} lap {p.generation}: {p.judged} judged, {p.refused} refused; foretold {told}, measured {was}"


def _percent(change: tuple[float, float, float]) -> str:
    return "{:+.1f} [{:+.1f} {:+.1f}]".format(*(100 * c for c in change))


def table(found: dict[str, Any]) -> Table:
    """The calibration as a table for a terminal."""
    shown = Table("estimate", "pairs", "covered", "with the measurement's error", "bias", "RMSE", "half width",
                  "Pearson", "signs", "MMRV", title="Expected change against measured change, points")
    for name, c in found["summary"].items():
        shown.add_row(name, str(c["pairs"]), str(c["covered"]), str(c["covered_with_error"]),
                      *(f"{100 * c[k]:+.1f}" for k in ("bias", "rmse", "half_width")), f"{c['pearson']:.3f}",
                      f"{c['clear_with_the_same_sign']} of {c['clear']}", f"{100 * c['rank_violation']:.1f}")
    return shown


def draw(found: dict[str, Any], path: Path) -> None:
    """The scatter plot as an SVG file: measured against foretold, with the interval of what was foretold."""
    rows = [[100 * v for v in (*p["disagreements"], p["measured"][0])] for p in found["pairs"]]
    told, low, high, was = (list(column) for column in zip(*rows, strict=True))
    tips = [f"seed {p['seed']}: foretold {_percent(p['disagreements'])}, measured {_percent(p['measured'])}"
            for p in found["pairs"]]
    limit = 5 * np.ceil(np.abs([*told, *was, *low, *high]).max() / 5)
    ticks = [float(t) for t in range(-100, 101, 10) if abs(t) <= limit]
    x, y = (Axis(label, -limit, limit, ticks) for label in ("measured at the exam, points", "expected"))
    chart = scatter_chart("calibration", [Line("pairs", was, told, 0, low=low, high=high, tips=tips)], x, y,
                          diagonal=True)
    title = f"Expected change of success (y), {len(rows)} pairs"
    with atomic(path) as stream:
        stream.write(alone(chart, title).encode())


def run_measure(*, seeds: int, recipe: str, pairs: int, draws: int, json: Path | None, svg: Path | None) -> None:
    """Measure, print, and leave the files that were asked for."""
    from flows.studies.measured import write_json

    console = Console(stderr=True)
    found = measure_counterfactual(seeds=seeds, recipe=recipe, pairs=pairs, draws=draws, say=console.print)
    Console().print(table(found))
    write_json(json, found)
    if svg is not None:
        draw(found, svg)
