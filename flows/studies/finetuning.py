"""The second half of `hardcase measure warmstart`: PPO goes on, with hard starts or with ordinary ones only."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from flows.rl.training import POLICY, trained
from flows.rl.warm import weights_of
from flows.studies.legged import ATTEMPTS, interval
from pipeline.files import short_id
from pipeline.locomotion.curriculum import Curriculum, HardStart
from pipeline.ppo.config import Order
from pipeline.statistics import bootstrap_difference

SOUGHT, TICKS = 1200, 300
"""Attempts from ordinary starts in which falls are sought, and how long they last: most falls come within 3 s."""
HARD_SHARE, SPREAD, RATE = 0.5, 0.5, 3e-4
"""Share of attempts that begin at hard starts, how far they are spread, learning rate of what goes on."""
SEEK, PUSH = 83, 89
"""Words that keep these seeds apart from those of training and evaluation."""
ARMS = ("before", "ordinary", "hard")
SETS = ("leaning", "thrown", "hard")
"""What each is judged on: two kinds of start, and states before falls that no training began at."""


def finetuned(orders: Mapping[int, Order], folders: Mapping[int, Path], root: Path, body: Any,
              further: int) -> dict[str, Any]:
    """Seek each policy's falls in simulation, go on from it on half of them, judge on the other half and ordinarily.

    Args:
        orders, folders: seed -> finished training.
        root: where what goes on is kept.
        body: the robot.
        further: steps of each training that goes on.
    """
    rows: list[dict[str, Any]] = []
    outcomes: dict[str, dict[str, list[Any]]] = {name: {arm: [] for arm in ARMS} for name in SETS}
    for k, order in orders.items():
        weights, identity = weights_of(folders[k])
        learned, fresh = falls_of(folders[k] / POLICY, body, order, k)
        ppo = order.ppo.model_copy(update={"steps": further, "learning_rate": RATE})
        ordinary = order.model_copy(update={"ppo": ppo, "goes_on": identity})
        hard = ordinary.model_copy(update={"stratum": None, "curriculum": Curriculum(
            kinds={order.stratum or next(iter(order.task.starts)): 1.0}, hard_share=HARD_SHARE, spread=SPREAD,
            starts=tuple(learned))})
        facts = {name: trained(one, root / f"{name}-{k}", weights=weights)
                 for name, one in (("ordinary", ordinary), ("hard", hard))}
        where = {"before": folders[k], **{name: root / f"{name}-{k}" for name in facts}}
        for arm, folder in where.items():
            for name, full in _judged(folder / POLICY, body, order, fresh, k).items():
                outcomes[name][arm].append(full)
        rows.append({"seed": k, "learned": len(learned), "fresh": len(fresh), "arms": {
            name: {key: one[key] for key in ("id", "steps", "cpu_s", "curve")} for name, one in facts.items()}})
    return {"further": further, "rows": rows, "rates": {name: _told(arms) for name, arms in outcomes.items()}}


def falls_of(policy: Path, body: Any, order: Order, seed: int) -> tuple[list[HardStart], list[Any]]:
    """States before this policy's falls: those to learn from, and as many that stay unseen; every other one."""
    from pipeline.locomotion.before_falls import play_from
    from pipeline.locomotion.starts import as_data, draw_start, seed_of
    from pipeline.ppo.runner import OnnxRunner

    stratum = order.stratum or next(iter(order.task.starts))
    starts = [draw_start(order.task, body, stratum, seed_of(seed, i, SEEK)) for i in range(SOUGHT)]
    before = play_from(OnnxRunner(policy), body, order.task, starts, ticks=TICKS).before
    found = [(i, as_data(start)) for i, start in sorted(before.items())]
    learned = [HardStart(case=short_id(order.id, str(i)), episode=short_id("sought", order.id, str(i)), family="fell",
                         generation=0, start=start) for i, start in found[::2]]
    return learned, [start for _, start in found[1::2]]


def _judged(policy: Path, body: Any, order: Order, fresh: list[Any], seed: int) -> dict[str, Any]:
    """Which attempts were full, by what they began at; blows at hard starts are drawn anew, the same for all arms."""
    from pipeline.locomotion.before_falls import play_from
    from pipeline.locomotion.evaluation import evaluate
    from pipeline.locomotion.starts import from_data, pushed, seed_of
    from pipeline.ppo.runner import OnnxRunner

    runner = OnnxRunner(policy)
    again = [pushed(from_data(start), order.task, seed_of(seed, i, PUSH)) for i, start in enumerate(fresh)]
    return {**{kind: evaluate(runner, body, order.task, n=ATTEMPTS, seed=seed, stratum=kind).full
               for kind in SETS[:2]}, "hard": play_from(runner, body, order.task, again).full}


def _told(arms: Mapping[str, list[Any]]) -> dict[str, Any]:
    """Rates by seed and overall, and the paired differences that matter. Seeds may have different numbers of starts."""
    rates = {arm: [float(full.mean()) for full in several] for arm, several in arms.items()}
    pairs = {f"{one} - {other}": _apart(arms[one], arms[other])
             for one, other in (("hard", "ordinary"), ("hard", "before"), ("ordinary", "before"))}
    return {"starts": [len(full) for full in arms["before"]], "rates": rates, "apart": pairs}


def _apart(first: list[Any], second: list[Any]) -> dict[str, float]:
    """Difference of success, seeds and starts drawn again; each seed counts the same."""
    least = min(len(full) for full in first)
    cut = [np.stack([full[:least] for full in arm]) for arm in (first, second)]
    found = bootstrap_difference({"all": (cut[0], cut[1])}, {"all": 1.0}, np.random.default_rng(0))
    return {"estimate": found.estimate, "low": found.low, "high": found.high}


def finetuning_table(found: Mapping[str, Any]) -> Table:
    """Who holds what, before and after going on; differences are paired by start."""
    table = Table("judged on", "starts a seed", *ARMS, "hard − ordinary", "hard − before", "ordinary − before",
                  title=f"{found['further']:,} further steps: full attempts, mean of the seeds (each seed)")
    for name, told in found["rates"].items():
        rates = [f"{np.mean(r):.3f} ({', '.join(f'{v:.2f}' for v in r)})" for r in map(told["rates"].get, ARMS) if r]
        table.add_row(name, "/".join(map(str, told["starts"])), *rates, *(
            interval(*(pair[key] for key in ("estimate", "low", "high"))) for pair in told["apart"].values()))
    return table
