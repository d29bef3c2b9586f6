"""Evaluations that are kept beside a training, so that the same is not played twice."""

import json
from pathlib import Path
from typing import Any

from flows.rl.training import BASELINES, POLICY, evaluated
from flows.studies.measured import write_json
from pipeline.files import sha256_file

KEPT = "evaluations.json"


def kept_evaluation(folder: Path, *, attempts: int, seed: int, stratum: str, threads: int = 1) -> dict[str, Any]:
    """What `evaluated` gives of the policy of a training, and as "outcomes" which attempts of each arm were full.

    What was played with this very policy is taken from evaluations.json; what does not fit together is played again.

    Args:
        folder: of a finished training.
        attempts, seed, stratum, threads: as for `evaluated`.
    """
    policy = sha256_file(folder / POLICY)
    asked = {"attempts": attempts, "seed": seed, "stratum": stratum, "policy_sha256": policy}
    there = _read(folder / KEPT)
    same = [one for one in there if all(one.get(key) == value for key, value in asked.items())]
    for found in same:
        if _whole(found, attempts):
            return found
    bits: dict[str, str] = {}
    found = evaluated(folder, attempts=attempts, seed=seed, stratum=stratum, threads=threads,
                      outcomes=lambda name, done: bits.update({name: "".join(str(int(one)) for one in done.full)}))
    found |= {"policy_sha256": policy, "outcomes": bits}
    others = [one for one in there if one.get("policy_sha256") == policy and one not in same]
    write_json(folder / KEPT, [*others, found])
    return found


def _read(file: Path) -> list[dict[str, Any]]:
    """Evaluations of a file of ours; none of another or a damaged one, which is written anew."""
    try:
        found: Any = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return []
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _whole(found: dict[str, Any], attempts: int) -> bool:
    """Whether every arm has its numbers, and outcomes that they follow from."""
    try:
        return set(found["arms"]) == {"policy", *BASELINES} and all(
            len(bits := found["outcomes"][name]) == attempts and set(bits) <= {"0", "1"}
            and bits.count("1") == arm["full"] and arm["rate"] == arm["full"] / attempts
            and all(isinstance(value, float) for value in (arm["low"], arm["high"], arm["length_s"],
                                                           *arm["terms"].values()))
            for name, arm in found["arms"].items())
    except (KeyError, TypeError, AttributeError):
        return False
