"""`hardcase measure stand`: does a trained robot stand, whatever pushes it, beside zero and random actions?"""

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from flows.rl.training import BASELINES, evaluated, trained
from flows.studies.measured import write_json
from pipeline.store import store_root

FIRST_SEED = 100
"""Of the study; numbers were tuned on seeds 0-9."""
ATTEMPTS = 300
TRAINED_ON, JUDGED_ON = "thrown", ("leaning", "thrown")
"""Kinds of start of the task `stand`: what is trained on is harder than the first that is judged on."""


def run_stand_study(*, seeds: int, body: str, json: Path | None) -> dict[str, Any]:
    """Train a seed after another, evaluate each beside the baselines, print the tables, and hand back everything.

    A seed that is finished is not trained again; one that was cut off goes on.

    Args:
        seeds: how many.
        body: key of LEGGED, or a path.
        json: where to write all of it, curves included.
    """
    from flows.rl.order import order_of

    rows: list[dict[str, Any]] = []
    full: dict[str, dict[str, list[Any]]] = {stratum: {} for stratum in JUDGED_ON}
    console = Console(stderr=True)
    for k in range(FIRST_SEED, FIRST_SEED + seeds):
        folder = store_root() / "rl" / "study" / f"{Path(body).stem}-stand-{k}"
        training = trained(order_of(body, "stand", k, stratum=TRAINED_ON), folder)
        arms = {stratum: evaluated(folder, attempts=ATTEMPTS, seed=k, stratum=stratum,
                                   outcomes=_keep(full[stratum]))["arms"] for stratum in JUDGED_ON}
        rows.append({"seed": k, "arms": arms} | {key: training[key] for key in (
            "steps", "cpu_s", "wall_s", "onnx_apart", "curve", "order")})
        console.print(f"seed {k}: {arms[JUDGED_ON[0]]['policy']['rate']:.3f} full attempts after "
                      f"{training['cpu_s']:.0f} CPU s")
    found = {"body": body, "task": "stand", "attempts": ATTEMPTS, "trained_on": TRAINED_ON, "rows": rows,
             "pooled": {stratum: pooled(arms) for stratum, arms in full.items()}}
    for stratum in JUDGED_ON:
        Console(width=120).print(table(found, stratum))
    write_json(json, found)
    return found


def _keep(arms: dict[str, list[Any]]) -> Any:
    return lambda name, done: arms.setdefault(name, []).append(done.full)


def pooled(arms: dict[str, list[Any]]) -> dict[str, Any]:
    """Rate of every arm over all seeds, and how far the policy is ahead of each baseline on the same starts."""
    import numpy as np

    from pipeline.statistics import bootstrap_difference

    outcomes = {name: np.stack(several) for name, several in arms.items()}
    nothing = np.zeros_like(outcomes["policy"])

    def apart(first: Any, second: Any) -> dict[str, float]:
        found = bootstrap_difference({"all": (first, second)}, {"all": 1.0}, np.random.default_rng(0))
        return {"estimate": found.estimate, "low": found.low, "high": found.high}

    return {"rate": {name: apart(values, nothing) for name, values in outcomes.items()},
            "ahead": {name: apart(outcomes["policy"], outcomes[name]) for name in BASELINES}}


def table(found: dict[str, Any], stratum: str) -> Table:
    """The study for people: full attempts of every seed and arm, and what a seed took."""
    shown = Table("seed", "policy", *BASELINES, "steps", "CPU s", "wall s",
                  title=f"{found['body']}, {stratum} starts: full attempts of {found['attempts']}, 95 % intervals")
    for row in found["rows"]:
        rates = [_interval(a["rate"], a["low"], a["high"]) for a in row["arms"][stratum].values()]
        shown.add_row(str(row["seed"]), *rates, f"{row['steps']:,}", f"{row['cpu_s']:.0f}", f"{row['wall_s']:.0f}")
    rates = [_interval(p["estimate"], p["low"], p["high"]) for p in found["pooled"][stratum]["rate"].values()]
    shown.add_row("all", *rates, "", "", "")
    return shown


def _interval(estimate: float, low: float, high: float) -> str:
    return f"{estimate:.3f} [{low:.3f} {high:.3f}]"
