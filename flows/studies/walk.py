"""`hardcase measure walk`: does a trained robot walk at the speed it is asked for, beside zero and random actions?"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from flows.rl.training import BASELINES
from flows.studies.legged import ATTEMPTS, Exam, interval, pooled, studied, table
from flows.studies.measured import write_json

SPEED_M_S, SPEEDS_M_S = 0.5, (0.0, 0.2, 0.4, 0.6, 0.8)
"""What is asked for in the first table, and in the second."""


def run_walk_study(*, seeds: int, body: str, json: Path | None) -> dict[str, Any]:
    """Train a seed after another, evaluate each at every speed beside the baselines, print, and hand back everything.

    An attempt walks if it has not fallen within its 10 s, and its mean speed forward from 2 s on is within .1 m/s of
    the speed asked for.

    Args:
        seeds: how many.
        body: key of LEGGED, or a path.
        json: where to write all of it, curves included.
    """
    exams = {_name(speed): Exam(speed=speed) for speed in (SPEED_M_S, *SPEEDS_M_S)}
    found, outcomes = studied(body, "walk", exams, seeds=seeds)
    found["pooled"] = {"full": {name: pooled(arms) for name, arms in outcomes.items()},
                       "walks": {name: pooled(arms, lambda done: done.follows) for name, arms in outcomes.items()}}
    found["speeds"] = {name: _speeds(arms) for name, arms in outcomes.items()}
    first, console = _name(SPEED_M_S), Console(width=120)
    for kind, says, share in (("walks", "full attempts within .1 m/s of the asked speed", lambda arm: arm["follows"]),
                              ("full", "full attempts", lambda arm: arm)):
        console.print(table(found["rows"], found["pooled"][kind][first], first,
                            f"{body}, {first}: {says}, of {ATTEMPTS}, 95 % intervals", share))
    console.print(_over_speeds(found))
    write_json(json, found)
    return found


def _name(speed_m_s: float) -> str:
    return f"{speed_m_s:g} m/s"


def _speeds(arms: Mapping[str, list[Any]]) -> dict[str, Any]:
    """Mean speeds of the policy's full attempts over all seeds: forward, left [m/s], turning [rad/s]; None without."""
    import numpy as np

    mean = np.concatenate([done.mean[done.full] for done in arms["policy"]])
    off = np.concatenate([done.mean[done.full, 0] - done.asked[done.full, 0] for done in arms["policy"]])
    if not len(mean):
        return {"mean": None, "off_m_s": None, "spread_m_s": None}
    return {"mean": mean.mean(axis=0).tolist(), "off_m_s": float(np.abs(off).mean()), "spread_m_s": float(off.std())}


def _over_speeds(found: Mapping[str, Any]) -> Table:
    shown = Table("asked", "walks", "full", *(f"{name} walks" for name in BASELINES), "speed [m/s]", "off [m/s]",
                  "turning [rad/s]", title="Over speeds, all seeds: policy, and baselines beside it")
    for name in map(_name, SPEEDS_M_S):
        walks, full = (found["pooled"][kind][name]["rate"] for kind in ("walks", "full"))
        told = found["speeds"][name]
        speeds = ("", "", "") if told["mean"] is None else (
            f"{told['mean'][0]:.3f}", f"{told['off_m_s']:.3f}", f"{told['mean'][2]:+.3f}")
        shown.add_row(name, interval(**walks["policy"]), interval(**full["policy"]),
                      *(interval(**walks[who]) for who in BASELINES), *speeds)
    return shown
