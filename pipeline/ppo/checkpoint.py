"""Checkpoints that a training resumes from bit for bit: one safetensors file with JSON in its header."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors import numpy as safetensors_numpy

from pipeline.errors import PolicyError
from pipeline.files import atomic

type Arrays = Mapping[str, NDArray[Any]]

untyped: Any = safetensors_numpy
"""Its arrays have no element types."""

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
    with atomic(path) as stream:
        stream.write(untyped.save(flat, {"training": json.dumps({"identity": identity, **saved.facts})}))
    for other in folder.glob("step-*.safetensors"):
        if other != path:
            other.unlink()
    return path


def newest(folder: Path) -> Path | None:
    """The checkpoint of the highest step in a folder, or None."""
    return max(folder.glob("step-*.safetensors"), default=None)


def load(path: Path, identity: str | None = None) -> Saved:
    """Read a checkpoint.

    Args:
        path: the file.
        identity: the training it must belong to; any where None.

    Raises:
        PolicyError: the file is damaged, or belongs to another training.
    """
    try:
        data = path.read_bytes()
        flat: dict[str, NDArray[Any]] = untyped.load(data)
        size = int.from_bytes(data[:8], "little")  # safetensors: header length, JSON header, tensors
        facts = json.loads(json.loads(data[8 : 8 + size])["__metadata__"]["training"])
        arrays: dict[str, dict[str, NDArray[Any]]] = {}
        for key, values in flat.items():
            part, name = key.split("/", 1)
            arrays.setdefault(part, {})[name] = values
        found = facts.pop("identity")
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise PolicyError(f"not a training checkpoint: {error}", where=path, mend=AGAIN) from error
    if identity is not None and found != identity:
        raise PolicyError("checkpoint of another training (body, task, numbers or seed differ)", where=path,
                          mend="give another folder, or " + AGAIN)
    return Saved(facts, arrays)
