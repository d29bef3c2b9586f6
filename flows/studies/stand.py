"""`hardcase measure stand`: does a trained robot stand, whatever pushes it, beside zero and random actions?"""

from pathlib import Path
from types import MappingProxyType
from typing import Any

from rich.console import Console

from flows.studies.legged import ATTEMPTS, Exam, pooled, studied, table
from flows.studies.measured import write_json

JUDGED_ON = ("leaning", "thrown")
"""Kinds of start of the task `stand`, the milder one first."""
TRAINED_ON = MappingProxyType({"unitree_h1": "leaning"})
"""Body -> kind of start that it is trained on; the harder one for others."""


def run_stand_study(*, seeds: int, body: str, json: Path | None) -> dict[str, Any]:
    """Train a seed after another, evaluate each beside the baselines, print the tables, and hand back everything.

    Args:
        seeds: how many.
        body: key of LEGGED, or a path.
        json: where to write all of it, curves included.
    """
    exams = {stratum: Exam(stratum) for stratum in JUDGED_ON}
    found, outcomes = studied(body, "stand", exams, seeds=seeds, trained_on=TRAINED_ON.get(body, JUDGED_ON[-1]))
    found["pooled"] = {stratum: pooled(arms) for stratum, arms in outcomes.items()}
    for stratum, overall in found["pooled"].items():
        title = f"{body}, {stratum} starts: full attempts of {ATTEMPTS}, 95 % intervals"
        Console(width=120).print(table(found["rows"], overall, stratum, title))
    write_json(json, found)
    return found
