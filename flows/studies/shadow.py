"""`hardcase measure shadow`: what each signal of shadow mode knows of a failure, and how early."""

import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from flows.run.opening import FIRST_HELD_OUT_TWIN
from flows.studies.measured import finished_loop, write_json
from flows.studies.shadow_attempts import SETTINGS, Attempt, Setting, attempts
from flows.studies.shadow_tables import tables
from pipeline.protocols import Array
from pipeline.recipes import load_recipe
from pipeline.signals.warning import ALARM, ALARM_TICKS, BIAS, WEIGHTS, fit, logarithms
from pipeline.signals.windows import first_lasting, last_until, mean_until
from pipeline.simulation.tasks import load_task
from pipeline.statistics.auroc import Scored, auroc, pooled_auroc
from schemas.recipe import LastingConfig

WINDOWS = (10, 20, 40, 80, 1000)
"""Ticks from the start; the last one is the whole attempt."""
FITTED = (10, 20, 40)
"""Windows that the warning is fitted on: those in which hardly an attempt has ended."""
TUNING, HELD_OUT = 800_000, 700_000
"""Added to the seed of the starts, so that they are those of no loop."""
REPLICATES = 1000
LENGTH = "length alone (control)"

type Runs = Mapping[str, Sequence[Sequence[Attempt]]]
"""Setting -> attempts of each seed."""


def run_shadow_study(*, seeds: int, recipe: str, json: Path | None) -> dict[str, Any]:
    """Deploy policies of finished loops on fresh starts with others in their shadow, and score every signal.

    Loop k works on twin k % 10 to fit the warning and on twin 100 + k for the figures.

    Args:
        seeds: how many loops.
        recipe: name or path.
        json: where to write all of it.
    """
    console, began = Console(stderr=True), time.process_time()
    rare = load_task(load_recipe(recipe).task).rare
    tuning: dict[str, list[list[Attempt]]] = {s.name: [] for s in SETTINGS}
    held_out: dict[str, list[list[Attempt]]] = {s.name: [] for s in SETTINGS}
    for k in range(seeds):
        with finished_loop(recipe, k) as steps:
            for setting in SETTINGS:
                tuning[setting.name].append(attempts(steps, setting, twin=k % 10, seed=TUNING + k))
                held_out[setting.name].append(attempts(steps, setting, twin=FIRST_HELD_OUT_TWIN + k,
                                                       seed=HELD_OUT + k))
        console.print(f"seed {k} finished, {k + 1} of {seeds}")
    found = {"fit": fitted(tuning), "shipped": {"bias": BIAS, "weights": dict(WEIGHTS)},
             "settings": {s.name: measured(held_out[s.name], s, rare) for s in SETTINGS},
             "tuning": {s.name: alarms(tuning[s.name]) for s in SETTINGS},
             "cpu_s": round(time.process_time() - began)}
    Console(width=120).print(*tables(found))
    write_json(json, found)
    return found


def fitted(runs: Runs) -> dict[str, Any]:
    """Bias and weights of the warning as these attempts give them."""
    columns, failed = list[Array](), list[float]()
    for several in runs.values():
        for run in several:
            for window in FITTED:
                means = {name: np.array([mean_until(a.signals[name], window) for a in run]) for name in WEIGHTS}
                columns.append(logarithms(means))
                failed += [float(a.failed) for a in run]
    bias, weights = fit(np.concatenate(columns), np.array(failed))
    return {"bias": round(bias, 2), "weights": dict(zip(WEIGHTS, (round(float(w), 2) for w in weights), strict=True))}


def measured(runs: Sequence[Sequence[Attempt]], setting: Setting, rare: Collection[str]) -> dict[str, Any]:
    """Everything about one setting: AUROC by signal and window, of all attempts and of those that go on, and alarms."""
    names = [*runs[0][0].signals, LENGTH]
    return {
        "champion": setting.champion, "candidates": setting.candidates,
        "attempts": sum(len(run) for run in runs), "failed": sum(a.failed for run in runs for a in run),
        "failed_rare": sum(a.failed and a.stratum in rare for run in runs for a in run),
        "auroc": {name: _by_window(runs, name) for name in names},
        "warning_by_twin": {str(w): [_rounded(auroc(_scores(run, "warning", w), _failed(run))) for run in runs]
                            for w in WINDOWS},
        "at_risk": {str(w): [sum(len(a) > w and a.failed == f for run in runs for a in run) for f in (True, False)]
                    for w in WINDOWS},
        "alarms": alarms(runs)}


def alarms(runs: Sequence[Sequence[Attempt]]) -> dict[str, Any]:
    """What the warning and a lasting disagreement would have said before the attempt's end, and how long before."""
    lasting, found = LastingConfig(), dict[str, Any]()
    rules = {f"warning above {ALARM:g} for {ALARM_TICKS} ticks": ("warning", ALARM, ALARM_TICKS),
             f"apart above {lasting.apart:g} for {lasting.ticks} ticks": ("apart", lasting.apart, lasting.ticks)}
    everything = [a for run in runs for a in run]
    for name, (signal, above, ticks) in rules.items():
        at = [first_lasting(a.signals[signal], above, ticks) for a in everything]
        hit = [(a, t) for a, t in zip(everything, at, strict=True) if t is not None]
        left = [len(a) - 1 - t for a, t in hit if a.failed]
        found[name] = {"failures": sum(a.failed for a in everything), "told": len(left),
                       "successes": sum(not a.failed for a in everything), "false": len(hit) - len(left),
                       "ticks_left": [int(v) for v in np.quantile(left, [0.25, 0.5, 0.75])] if left else []}
    return found


def _by_window(runs: Sequence[Sequence[Attempt]], name: str) -> dict[str, Any]:
    rng, found = np.random.default_rng([0xA0C, len(name)]), dict[str, Any]()
    for window in WINDOWS:
        every = [Scored(_scores(run, name, window), _failed(run)) for run in runs]
        on = [[a for a in run if len(a) > window] for run in runs]
        going = [Scored(_scores(run, name, window), _failed(run)) for run in on]
        all_of_them, still = (pooled_auroc(r, rng, replicates=REPLICATES) for r in (every, going))
        found[str(window)] = {kind: None if i is None else [_rounded(v) for v in (i.estimate, i.low, i.high)]
                              for kind, i in (("all", all_of_them), ("running", still))}
    return found


def _scores(run: Sequence[Attempt], name: str, window: int) -> Array:
    """What a signal says at the end of a window, or of the attempt where that is earlier, to 12 places: equal means
    of unequal numbers of ticks are ties."""
    if name == LENGTH:
        return np.array([float(min(len(a), window)) for a in run])
    if name == "warning":  # made of means already
        return np.round([last_until(a.signals[name], window) for a in run], 12)
    return np.round([mean_until(a.signals[name], window) for a in run], 12)


def _failed(run: Sequence[Attempt]) -> Any:
    return np.array([a.failed for a in run], dtype=bool)


def _rounded(value: float) -> float | None:
    return None if np.isnan(value) else round(value, 4)
