"""`hardcase measure warmstart`: what does PPO gain from a cloned expert, and from hard starts afterwards?"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from flows.rl.cloning import BALANCE, REPORT, cloned
from flows.rl.order import order_of
from flows.rl.training import POLICY, trained
from flows.rl.warm import WEIGHTS
from flows.studies.finetuning import finetuned, finetuning_table
from flows.studies.legged import ATTEMPTS, FIRST_SEED, interval
from flows.studies.measured import write_json
from pipeline.ppo.config import Order
from pipeline.ppo.curves import Point
from pipeline.statistics import bootstrap_difference, wilson
from pipeline.store import store_root

BODY, TASK, TRAINED_ON, JUDGED_ON = "biped", "stand", "thrown", ("leaning", "thrown")
EXPERTS = ("balance", "teacher")
"""The controller written by hand, and the finished policy of the study's next seed."""
SHOWN = {"balance": ("leaning", True), "teacher": ("thrown", False)}
"""Expert -> kind of start that it demonstrates from, and whether no blows come meanwhile."""
DEMONSTRATED = 100
"""Attempts of an expert that reached their end."""
WARM_LOG_STD = -2.0
"""Actions are drawn closer about a clone than about random weights: with the usual -1 a clone falls as soon as random
weights do (seed 0)."""
SHARES, OVER = (0.5, 0.9), 20
"""Shares of full attempts that are waited for, over so many iterations."""
ARMS = ("scratch", "balance", "teacher")


def run_warmstart_study(*, seeds: int, steps: int | None, further: int, json: Path | None) -> dict[str, Any]:
    """Train a seed after another, print both tables, and hand back everything; what is finished is not done again.

    Args:
        seeds: how many.
        steps: of each training; as many as the task has where None.
        further: steps of each training that goes on, on hard or on ordinary starts.
        json: where to write all of it, curves included.
    """
    from pipeline.locomotion.bodies import load_legged

    body, console = load_legged(BODY), Console(stderr=True)
    root = store_root() / "rl" / "study"
    orders = {k: order_of(BODY, TASK, k, stratum=TRAINED_ON, given={"steps": steps})
              for k in range(FIRST_SEED, FIRST_SEED + seeds)}
    folders = {k: root / f"{BODY}-{TASK}-{k}" for k in orders}
    rows: list[dict[str, Any]] = []
    for k, order in orders.items():
        rows.append({"seed": k, "arms": {"scratch": _facts(trained(order, folders[k]), 0)}, "clones": {}})
        console.print(f"seed {k} from scratch: {rows[-1]['arms']['scratch']['reached']}")
    for row in rows:
        k = row["seed"]
        expert = {"balance": BALANCE, "teacher": str(folders[FIRST_SEED + (k - FIRST_SEED + 1) % seeds])}
        for name in EXPERTS:
            found, training = _warm(orders[k], expert[name], name, root / "warm" / f"{name}-{k}")
            row["clones"][name] = {key: found[key] for key in ("demonstrations", "epochs", "weights", "onnx_apart")}
            row["arms"][name] = _facts(training, found["demonstrations"]["steps"])
            console.print(f"seed {k} from {name}: {row['arms'][name]['reached']}")
    outcomes = {k: _judged(body, orders[k].task, k, {
        "scratch": folders[k], **{name: root / "warm" / f"{name}-{k}" / "ppo" for name in EXPERTS},
        **{f"clone of {name}": root / "warm" / f"{name}-{k}" for name in EXPERTS}}) for k in orders}
    fine = finetuned(orders, folders, root / "warm", body, further)
    found = {"body": BODY, "task": TASK, "trained_on": TRAINED_ON, "attempts": ATTEMPTS, "rows": rows,
             "rates": _rates(outcomes), "finetuning": fine}
    write_json(json, found)
    shown = Console(width=150)
    for table in (_reached(found), *(_rate_table(found, stratum) for stratum in JUDGED_ON), finetuning_table(fine)):
        shown.print(table)
    return found


def _warm(order: Order, expert: str, name: str, folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """A clone, and PPO from there; facts of both."""
    import json as jsonlib

    stratum, calm = SHOWN[name]
    begins = order.model_copy(update={"ppo": order.ppo.model_copy(update={"log_std": WARM_LOG_STD})})
    shown = begins.model_copy(update={"stratum": stratum})
    if (folder / REPORT).exists():
        found = jsonlib.loads((folder / REPORT).read_text())
    else:
        found = cloned(shown, expert, folder, attempts=DEMONSTRATED, calm=calm)
    return found, trained(begins.model_copy(update={"goes_on": found["weights"]}), folder / "ppo",
                          weights=folder / WEIGHTS)


def _facts(training: Mapping[str, Any], before: int) -> dict[str, Any]:
    """What is kept of a training: steps that the demonstrations took are counted as its own."""
    return {key: training[key] for key in ("id", "steps", "cpu_s", "curve")} | {
        "demonstrated": before, "reached": {str(share): steps_to(training["curve"], share, before) for share in SHARES}}


def steps_to(curve: list[Point], share: float, before: int = 0) -> int | None:
    """Environment steps after which this share of the attempts that ended within OVER iterations was full.

    Args:
        curve: of the training.
        share: in (0, 1].
        before: steps that were taken before the training.
    """
    ended = np.array([point["full"] + point["fallen"] for point in curve], float)
    full = np.array([point["full"] for point in curve], float)
    window = np.ones(OVER)
    if len(curve) < OVER:
        return None
    rate = np.convolve(full, window, "valid") / np.maximum(1.0, np.convolve(ended, window, "valid"))
    enough = np.flatnonzero(rate >= share)
    return int(curve[int(enough[0]) + OVER - 1]["step"]) + before if len(enough) else None


def _judged(body: Any, task: Any, seed: int, folders: Mapping[str, Path]) -> dict[str, dict[str, Any]]:
    """Kind of start -> policy -> which of its attempts were full; the same starts for all."""
    from pipeline.locomotion.evaluation import evaluate
    from pipeline.ppo.runner import OnnxRunner

    runners = {name: OnnxRunner(folder / POLICY) for name, folder in folders.items()}
    return {stratum: {name: evaluate(runner, body, task, n=ATTEMPTS, seed=seed, stratum=stratum).full
                      for name, runner in runners.items()} for stratum in JUDGED_ON}


def _rates(outcomes: Mapping[int, dict[str, dict[str, Any]]]) -> dict[str, Any]:
    """Kind of start -> policy -> its rate in every seed, over all, and how far it is ahead of scratch, paired."""
    found: dict[str, Any] = {}
    for stratum in JUDGED_ON:
        names = next(iter(outcomes.values()))[stratum]
        stacked = {name: np.stack([one[stratum][name] for one in outcomes.values()]) for name in names}
        found[stratum] = {name: {
            "seeds": [wilson(int(row.sum()), len(row)).model_dump() for row in values],
            "all": ahead(values, np.zeros_like(values)), "ahead": ahead(values, stacked["scratch"]),
        } for name, values in stacked.items()}
    return found


def ahead(first: Any, second: Any) -> dict[str, float]:
    """Success of the first minus that of the second on the same starts, seeds and starts drawn again."""
    found = bootstrap_difference({"all": (first, second)}, {"all": 1.0}, np.random.default_rng(0))
    return {"estimate": found.estimate, "low": found.low, "high": found.high}


def _reached(found: Mapping[str, Any]) -> Table:
    table = Table("seed", *(f"{arm}: steps to {share:g}" for share in SHARES for arm in ARMS), "CPU s",
                  title="Full attempts in training on thrown starts, demonstrations counted")
    for row in found["rows"]:
        reached = [row["arms"][arm]["reached"][str(share)] for share in SHARES for arm in ARMS]
        cpu = " / ".join(f"{row['arms'][arm]['cpu_s']:.0f}" for arm in ARMS)
        table.add_row(str(row["seed"]), *("never" if at is None else f"{at:,}" for at in reached), cpu)
    return table


def _rate_table(found: Mapping[str, Any], stratum: str) -> Table:
    rates = found["rates"][stratum]
    table = Table("policy", *(str(row["seed"]) for row in found["rows"]), "all", "ahead of scratch, paired",
                  title=f"{stratum} starts: full attempts of {found['attempts']}, 95 % intervals")
    for name, told in rates.items():
        table.add_row(name, *(interval(s["rate"], s["low"], s["high"]) for s in told["seeds"]),
                      interval(*(told["all"][key] for key in ("estimate", "low", "high"))),
                      "" if name == "scratch" else signed(told["ahead"]))
    return table


def signed(found: Mapping[str, float]) -> str:
    """A difference and its interval."""
    return f"{found['estimate']:+.3f} [{found['low']:+.3f} {found['high']:+.3f}]"
