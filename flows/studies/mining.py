"""The studies of mining: corrections in the order of their worth against any, and families against known causes."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from flows.run.mining import before
from flows.studies.measured import finished_loop, write_json
from flows.studies.mining_lap import Said, Way, lap, rates
from pipeline.files import short_id
from pipeline.mining.families import agreement
from pipeline.mining.planted import PLANTED, fail
from pipeline.recipes import load_recipe
from pipeline.simulation.tasks import load_task
from pipeline.statistics import bootstrap_difference, sign_test
from pipeline.store import store_root
from schemas.hardcase import HardCase
from schemas.recipe import Recipe
from stages.mine import mine, nowhere

AIMED = 4
"""Corrections at which beginning at the subtask is tried, too."""
CONTROL = "random"
COLUMNS = ("failures", "families", "agreement", "by trigger")
EACH = 24
"""Attempts of each planted cause."""


def run_mining(*, seeds: int, recipe: str, budgets: Sequence[int], json: Path | None) -> None:
    """The same few corrections by value, at random and in turn: one lap from a shared generation 0, paired by seed."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    ways: list[Way] = [(order, n, "trigger") for n in budgets for order in (CONTROL, "value", "in-turn")]
    ways += [("value", AIMED, "subtask")] if AIMED in budgets else []
    folder, found = store_root() / "study" / Path(recipe).stem / "mining", dict[Way, list[Said]]()
    for way in ways:
        for k in range(seeds):
            with finished_loop(recipe, k) as steps:
                found.setdefault(way, []).append(lap(steps, way, folder))
            Console(stderr=True).print(f"{' '.join(map(str, way))}: seed {k} finished", highlight=False)
    shares = _shares(load_recipe(recipe))
    table = Table("corrections", "order", "begins at", "mix", *shares, "ahead of random, points", "of in turn, points",
                  "seeds ahead of random", "p", title=f"one lap, {seeds} seeds")
    told: list[Said] = []
    for way, runs in found.items():
        said: Said = {"way": list(way), "seeds": runs, "mix": [_mix(r, shares) for r in runs]}
        for other in (CONTROL, "in-turn"):
            rivals = found[other, way[1], "trigger"]
            said[other] = None if rivals is runs else _against(runs, rivals, shares)
        told.append(said)
        against = said[CONTROL]
        table.add_row(str(way[1]), way[0], way[2], f"{np.mean(said['mix']):.3f}",
                      *(f"{np.mean([rates(r, [s]) for r in runs]):.2f}" for s in shares),
                      _interval(against), _interval(said["in-turn"]),
                      f"{against['wins']} of {against['wins'] + against['losses']}" if against else "",
                      f"{against['p']:.3f}" if against else "")
    Console().print(table)
    write_json(json, told)


def _shares(recipe: Recipe) -> dict[str, float]:
    task, share = load_task(recipe.task), recipe.deploy.rare_share
    return ({n: (1 - share) / len(task.common) for n in task.common}
            | {n: share * part / sum(task.rare.values()) for n, part in task.rare.items()})


def _mix(said: Said, shares: dict[str, float]) -> float:
    return sum(share * rates(said, [name]) for name, share in shares.items())


def _against(runs: Sequence[Said], rivals: Sequence[Said], shares: dict[str, float]) -> Said:
    """Pooled difference at the mix with its interval, and the seeds that were ahead."""
    strata = np.array(runs[0]["strata"])
    one, two = (np.array([[b == "1" for b in r["bits"]] for r in side]) for side in (runs, rivals))
    pooled = bootstrap_difference({s: (one[:, strata == s], two[:, strata == s]) for s in shares}, shares,
                                  np.random.default_rng(83))
    test = sign_test([_mix(a, shares) - _mix(b, shares) for a, b in zip(runs, rivals, strict=True)])
    return {"points": 100 * pooled.estimate, "low": 100 * pooled.low, "high": 100 * pooled.high, "wins": test.wins,
            "losses": test.losses, "p": test.p_two_sided}


def _interval(against: Said | None) -> str:
    return f"{against['points']:+.1f} [{against['low']:+.1f} {against['high']:+.1f}]" if against else ""


def run_families(*, seeds: int, recipe: str, json: Path | None) -> None:
    """Known causes planted in simulation, and the kinds of start of the twins' own failures: do families tell them."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    table = Table("seed", "planted: failures", "families", "agreement", "by trigger", "twin: failures", "families",
                  "agreement", "by trigger", title="adjusted Rand index with the cause, 1 is perfect and 0 is chance")
    told: list[Said] = []
    for k in range(seeds):
        with finished_loop(recipe, k) as steps:
            policy, knew = steps.policy(steps.material.ids(0, "train")[0]), before(steps, 0)
            planted = {n: [plant(EACH * k + i) for i in range(EACH)] for n, plant in PLANTED.items()}
            causes = [name for name, scenes in planted.items() for _ in scenes]
            failed = fail(policy, [s for scenes in planted.values() for s in scenes], steps.recipe.harvest)
            named = [(short_id(i), causes[i], trace, trigger) for i, trace, trigger in failed]
            twins = [(e.id, e.scene.stratum, t, str(e.outcome.family)) for e, t in steps.material.failed_attempts(0)]
        said: Said = {"seed": k}
        for kind, rows in (("planted", named), ("twin", twins)):
            cases = [HardCase(id=id, episode=id, trigger="", tick=0, family=family, stratum="", generation=0)
                     for id, _, _, family in rows]
            mined = mine(cases, {id: trace for id, _, trace, _ in rows}, knew, solved=nowhere(), generation=0)
            truth = [cause for _, cause, _, _ in rows]
            said[kind] = {"failures": len(rows), "families": len(mined.new),
                          "agreement": agreement([c.found for c in mined.cases], truth),
                          "by trigger": agreement([c.family for c in cases], truth)}
        told.append(said)
        table.add_row(str(k), *(f"{v:.2f}" if isinstance(v, float) else str(v)
                                for kind in ("planted", "twin") for v in said[kind].values()))
    means = [np.mean([t[kind][n] for t in told]) for kind in ("planted", "twin") for n in COLUMNS]
    table.add_row("mean", *(f"{m:.2f}" for m in means))
    Console().print(table)
    write_json(json, told)
