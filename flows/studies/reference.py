"""`hardcase measure reference`: Hopper and HalfCheetah with published numbers, through ours and through DummyVecEnv."""

import json as jsonlib
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from flows.studies.measured import write_json
from flows.studies.reference_tables import tables
from pipeline.files import atomic
from pipeline.ppo.reference import PUBLISHED, ZOO, Arm, ReferenceOrder
from pipeline.store import store_root

FIRST_SEED = 100
RUN = "run.json"
"""What a finished training leaves in its folder beside its last checkpoint."""
ORDER: tuple[Arm, ...] = ("ours", "dummy")
"""All of the first are trained before any of the second."""


def run_reference_study(*, seeds: int, steps: int, episodes: int, train: bool, json: Path | None) -> dict[str, Any]:
    """Train and evaluate what is not finished yet, one after another, print the tables, and hand back everything.

    A training that was cut off goes on from its checkpoint, to the bits of one that was not.

    Args:
        seeds: how many, of each task and arm.
        steps: environment steps of each training.
        episodes: deterministic ones that each is judged on.
        train: whether to train at all, or only to tell of what is finished.
        json: where to write all of it, curves and single returns included.
    """
    console = Console(stderr=True)
    orders = [ReferenceOrder(task=task, arm=arm, ppo=ZOO[task].model_copy(update={"steps": steps}), seed=seed)
              for arm in ORDER for task in ZOO for seed in range(FIRST_SEED, FIRST_SEED + seeds)]
    runs: list[dict[str, Any]] = []
    for order in orders:
        found = _finished(order, episodes)
        if found is None and train:
            found = _train(order, episodes, console)
        if found is not None:
            runs.append(found)
    missing = [_name(order) for order in orders if _finished(order, episodes) is None]
    whole = {"steps": steps, "episodes": episodes, "published": dict(PUBLISHED), "runs": runs, "missing": missing}
    whole["pooled"] = pooled(runs)
    for table in tables(whole):
        Console(width=120).print(table)
    if missing:
        console.print(f"not finished: {', '.join(missing)}")
    write_json(json, whole)
    return whole


def folder_of(order: ReferenceOrder) -> Path:
    """Where a training of the study lies."""
    return store_root() / "rl" / "reference" / f"{_name(order)}-{order.ppo.steps}"


def _name(order: ReferenceOrder) -> str:
    return f"{order.task}-{order.arm}-{order.seed}"


def _finished(order: ReferenceOrder, episodes: int) -> dict[str, Any] | None:
    """What a training left, if it is at its end and was judged on as many episodes."""
    file = folder_of(order) / RUN
    found = jsonlib.loads(file.read_bytes()) if file.exists() else None
    return found if found is not None and len(found["returns"]) == episodes else None


def _train(order: ReferenceOrder, episodes: int, console: Console) -> dict[str, Any]:
    """One training from where it stands to its end, and its evaluation."""
    from pipeline.ppo.reference_training import ReferenceTraining

    folder = folder_of(order)
    folder.mkdir(parents=True, exist_ok=True)
    training = ReferenceTraining(order, folder)
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24),
               TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(_name(order), total=order.ppo.steps, completed=training.steps)
        training.run(lambda point: bar.update(task, completed=point[0]))
    returns, lengths = training.evaluate(episodes, order.seed)
    found: dict[str, Any] = {
        "task": order.task, "arm": order.arm, "seed": order.seed, "id": order.id, "steps": training.steps,
        "cpu_s": training.cpu_s, "wall_s": training.wall_s, "weights": training.digest, "curve": training.curve,
        "returns": returns.tolist(), "lengths": lengths.tolist(), "order": order.model_dump(mode="json")}
    with atomic(folder / RUN) as stream:
        stream.write(jsonlib.dumps(found).encode())
    console.print(f"{_name(order)}: {returns.mean():.0f} a deterministic episode after {training.cpu_s:.0f} CPU s")
    return found


def pooled(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Of every task and arm: the interquartile mean with its interval, the mean, and its share of the published one.

    And of every task: of how many seeds both arms are finished, and in how many of those all weights are equal.
    """
    import numpy as np

    from pipeline.statistics import bootstrap_interquartile

    told: dict[str, Any] = {}
    for task, published in PUBLISHED.items():
        arms: dict[str, Any] = {}
        for arm in ORDER:
            mine = [run for run in runs if (run["task"], run["arm"]) == (task, arm)]
            if not mine:
                continue
            returns = np.array([run["returns"] for run in mine])
            found = bootstrap_interquartile(returns, np.random.default_rng(0))
            arms[arm] = {
                "seeds": [run["seed"] for run in mine], "iqm": found.estimate, "low": found.low, "high": found.high,
                "mean": float(returns.mean()), "share": float(returns.mean()) / published,
                "steps_a_cpu_s": sum(run["steps"] for run in mine) / sum(run["cpu_s"] for run in mine)}
        weights = [{run["seed"]: run["weights"] for run in runs if (run["task"], run["arm"]) == (task, arm)}
                   for arm in ORDER]
        both = sorted(weights[0].keys() & weights[1].keys())
        told[task] = {"arms": arms, "both": both, "equal": [k for k in both if weights[0][k] == weights[1][k]]}
    return told
