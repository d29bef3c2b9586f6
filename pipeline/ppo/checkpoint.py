"""Checkpoints that a training resumes from bit for bit: one safetensors file with JSON in its header."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import PolicyError
from pipeline.policies.resuming import keep, readable, unpacked

type Arrays = Mapping[str, NDArray[Any]]

AGAIN = "remove it and train again: the same order gives the same weights"


@dataclass(frozen=True, slots=True)
class Saved:
    """Everything that the rest of a training depends on."""

    facts: dict[str, Any]
    """Counters, schedules and curves, as JSON."""
    arrays: dict[str, dict[str, NDArray[Any]]]
    """Part -> name -> array; parts are weights, optimiser, normaliser, attempts, generators, last."""


def save(folder: Path, identity: str, step: int, saved: Saved) -> Path:
    """Write a checkpoint and drop older ones; a kill at any point leaves the newest whole one."""
    path = folder / f"step-{step:010d}.safetensors"
    flat = {f"{part}/{name}": np.ascontiguousarray(values)
            for part, arrays in saved.arrays.items() for name, values in arrays.items()}
    return keep(path, flat, {"identity": identity, **saved.facts})


def load(path: Path, identity: str | None = None) -> Saved:
    """Read a checkpoint.

    Args:
        path: the file.
        identity: the training it must belong to; any where None.

    Raises:
        PolicyError: the file is damaged, or belongs to another training.
    """
    with readable(path, AGAIN):
        facts, flat = unpacked(path)
        arrays: dict[str, dict[str, NDArray[Any]]] = {}
        for key, values in flat.items():
            part, name = key.split("/", 1)
            arrays.setdefault(part, {})[name] = values
        found = facts.pop("identity")
    if identity is not None and found != identity:
        raise PolicyError("checkpoint of another training (body, task, numbers or seed differ)", where=path,
                          mend="give another folder, or " + AGAIN)
    return Saved(facts, arrays)
