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
    the speed asked for. Whether it is a gait, the last table tells: each foot comes down once in a period of the clock.

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
    first, console = _name(SPEED_M_S), Console(width=160)
    for kind, says, share in (("walks", "full attempts within .1 m/s of the asked speed", lambda arm: arm["follows"]),
                              ("full", "full attempts", lambda arm: arm)):
        console.print(table(found["rows"], found["pooled"][kind][first], first,
                            f"{body}, {first}: {says}, of {ATTEMPTS}, 95 % intervals", share))
    console.print(_over_speeds(found))
    write_json(json, found)
    return found


def _name(speed_m_s: float) -> str:
    return f"{speed_m_s:g} m/s"


def _speeds(arms: Mapping[str, list[Any]]) -> dict[str, Any] | None:
    """What the policy's full attempts of all seeds do: speeds, how far off them, and whether it is a gait."""
    import numpy as np

    full = [(done, done.full) for done in arms["policy"]]
    if not any(bits.any() for _, bits in full):
        return None
    mean = np.concatenate([done.mean[bits] for done, bits in full])
    off = mean[:, 0] - np.concatenate([done.asked[bits, 0] for done, bits in full])
    return {"mean": mean.mean(axis=0).tolist(), "off_m_s": float(np.abs(off).mean()),
            "most_off_m_s": float(np.abs(off).max()),
            "steps_hz": float(np.concatenate([done.steps_hz[bits] for done, bits in full]).mean()),
            "airborne": float(np.concatenate([done.airborne[bits] for done, bits in full]).mean())}


def _over_speeds(found: Mapping[str, Any]) -> Table:
    shown = Table("asked", "walks", "full", *(f"{name} walks" for name in BASELINES), "forward [m/s]", "off [m/s]",
                  "turning [rad/s]", "steps a foot [1/s]", "in the air",
                  title="Over speeds, all seeds: the policy, and whether the baselines walk")
    for name, told in found["speeds"].items():
        walks, full = (found["pooled"][kind][name]["rate"] for kind in ("walks", "full"))
        speeds = [""] * 5 if told is None else [
            f"{told['mean'][0]:.3f}", f"{told['off_m_s']:.3f}", f"{told['mean'][2]:+.3f}", f"{told['steps_hz']:.2f}",
            f"{told['airborne']:.3f}"]
        shown.add_row(name, interval(**walks["policy"]), interval(**full["policy"]),
                      *(interval(**walks[who]) for who in BASELINES), *speeds)
    return shown
