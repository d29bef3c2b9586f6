"""Studies of legged robots: trainings of several seeds, each examined beside zero and random action, and pooled."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from flows.rl.training import BASELINES, evaluated, trained
from pipeline.store import store_root

FIRST_SEED = 100
"""Of a study; numbers were tuned on seeds 0-9."""
ATTEMPTS = 300


@dataclass(frozen=True, slots=True)
class Exam:
    """What trained robots are asked to do."""

    stratum: str | None = None
    """Kind of start; the first of the task where None."""
    speed: float | None = None
    """Forward [m/s]; as the task draws it where None."""


type Outcomes = dict[str, dict[str, list[Any]]]
"""Exam -> who acts -> Evaluated of each seed."""


def studied(body: str, task: str, exams: Mapping[str, Exam], *, seeds: int,
            trained_on: str | None = None) -> tuple[dict[str, Any], Outcomes]:
    """Train a seed after another, examine each beside the baselines; facts, and what happened in every attempt.

    A seed that is finished is not trained again; one that was cut off goes on.

    Args:
        body, task: as on the command line.
        exams: name -> what is asked.
        seeds: how many.
        trained_on: kind of start of the trainings.
    """
    from flows.rl.order import order_of

    rows: list[dict[str, Any]] = []
    outcomes: Outcomes = {name: {} for name in exams}
    console = Console(stderr=True)
    for k in range(FIRST_SEED, FIRST_SEED + seeds):
        folder = store_root() / "rl" / "study" / f"{Path(body).stem}-{task}-{k}"
        training = trained(order_of(body, task, k, stratum=trained_on), folder)
        arms = {name: evaluated(folder, attempts=ATTEMPTS, seed=k, stratum=exam.stratum, speed=exam.speed,
                                outcomes=_keep(outcomes[name]))["arms"] for name, exam in exams.items()}
        rows.append({"seed": k, "arms": arms} | {key: training[key] for key in (
            "steps", "cpu_s", "wall_s", "onnx_apart", "curve", "order")})
        console.print(f"seed {k}: {arms[next(iter(exams))]['policy']['rate']:.3f} full attempts after "
                      f"{training['cpu_s']:.0f} CPU s")
    return {"body": body, "task": task, "attempts": ATTEMPTS, "trained_on": trained_on, "rows": rows}, outcomes


def _keep(arms: dict[str, list[Any]]) -> Callable[[str, Any], None]:
    return lambda name, done: arms.setdefault(name, []).append(done)


def pooled(arms: Mapping[str, list[Any]], passed: Callable[[Any], Any] = lambda done: done.full) -> dict[str, Any]:
    """Rate of every arm over all seeds, and how far the policy is ahead of each baseline on the same starts.

    Args:
        arms: who acts -> Evaluated of each seed.
        passed: which attempts of an Evaluated count.
    """
    import numpy as np

    from pipeline.statistics import bootstrap_difference

    outcomes = {name: np.stack([passed(done) for done in several]) for name, several in arms.items()}
    nothing = np.zeros_like(outcomes["policy"])

    def apart(first: Any, second: Any) -> dict[str, float]:
        found = bootstrap_difference({"all": (first, second)}, {"all": 1.0}, np.random.default_rng(0))
        return {"estimate": found.estimate, "low": found.low, "high": found.high}

    return {"rate": {name: apart(values, nothing) for name, values in outcomes.items()},
            "ahead": {name: apart(outcomes["policy"], outcomes[name]) for name in BASELINES}}


def table(rows: list[dict[str, Any]], overall: Mapping[str, Any], exam: str, title: str,
          share: Callable[[Mapping[str, Any]], Mapping[str, float]] = lambda arm: arm) -> Table:
    """One exam for people: what every seed and arm did, and what a seed took.

    Args:
        rows: of `studied`.
        overall: of `pooled`.
        exam: its name.
        title: says what the rates are.
        share: rate, low and high of an arm.
    """
    shown = Table("seed", "policy", *BASELINES, "steps", "CPU s", "wall s", title=title)
    for row in rows:
        rates = [interval(s["rate"], s["low"], s["high"]) for s in map(share, row["arms"][exam].values())]
        shown.add_row(str(row["seed"]), *rates, f"{row['steps']:,}", f"{row['cpu_s']:.0f}", f"{row['wall_s']:.0f}")
    rates = [interval(p["estimate"], p["low"], p["high"]) for p in overall["rate"].values()]
    shown.add_row("all", *rates, "", "", "")
    return shown


def interval(estimate: float, low: float, high: float) -> str:
    """A share and its interval."""
    return f"{estimate:.3f} [{low:.3f} {high:.3f}]"
