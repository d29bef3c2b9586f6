"""`hardcase measure stand`: can the biped stand up from bad starts and under pushes, beside zero and random actions?"""

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from flows.measured import write_json
from flows.rl import BASELINES, evaluated, trained
from pipeline.store import store_root

FIRST_SEED = 100
"""Of the study; numbers were tuned on seeds 0-9."""
ATTEMPTS = 300


def run_stand_study(*, seeds: int, body: str, json: Path | None) -> dict[str, Any]:
    """Train a seed after another, evaluate each beside the baselines, print the table, and hand back everything.

    A seed that is finished is not trained again; one that was cut off goes on.

    Args:
        seeds: how many.
        body: key of LEGGED, or a path.
        json: where to write all of it, curves included.
    """
    import numpy as np

    from flows.rl_order import order_of
    from pipeline.statistics import bootstrap_difference

    rows: list[dict[str, Any]] = []
    full: dict[str, list[Any]] = {}
    console = Console(stderr=True)
    for k in range(FIRST_SEED, FIRST_SEED + seeds):
        folder = store_root() / "rl" / "study" / f"{Path(body).stem}-stand-{k}"
        training = trained(order_of(body, "stand", k), folder)
        arms = evaluated(folder, attempts=ATTEMPTS, seed=k,
                         outcomes=lambda name, done: full.setdefault(name, []).append(done.full))["arms"]
        rows.append({"seed": k, "arms": arms} | {key: training[key] for key in (
            "steps", "cpu_s", "wall_s", "onnx_apart", "curve", "order")})
        console.print(f"seed {k}: {arms['policy']['rate']:.3f} full attempts after {training['cpu_s']:.0f} CPU s")
    outcomes = {name: np.stack(several) for name, several in full.items()}
    none = np.zeros_like(outcomes["policy"])

    def pooled(first: Any, second: Any) -> dict[str, float]:
        found = bootstrap_difference({"all": (first, second)}, {"all": 1.0}, np.random.default_rng(0))
        return {"estimate": found.estimate, "low": found.low, "high": found.high}

    found = {"body": body, "task": "stand", "attempts": ATTEMPTS, "rows": rows,
             "pooled": {name: pooled(values, none) for name, values in outcomes.items()},
             "ahead": {name: pooled(outcomes["policy"], outcomes[name]) for name in BASELINES}}
    Console(width=120).print(table(found))
    write_json(json, found)
    return found


def table(found: dict[str, Any]) -> Table:
    """The study for people: full attempts of every seed and arm, and what a seed took."""
    shown = Table("seed", "policy", *BASELINES, "steps", "CPU s", "wall s", title=f"{found['body']}: full attempts of "
                  f"{found['attempts']}, with 95 % intervals")
    for row in found["rows"]:
        rates = [f"{a['rate']:.3f} [{a['low']:.3f} {a['high']:.3f}]" for a in row["arms"].values()]
        shown.add_row(str(row["seed"]), *rates, f"{row['steps']:,}", f"{row['cpu_s']:.0f}", f"{row['wall_s']:.0f}")
    rates = [f"{p['estimate']:.3f} [{p['low']:.3f} {p['high']:.3f}]" for p in found["pooled"].values()]
    shown.add_row("all", *rates, "", "", "")
    return shown
