"""Resumable training checkpoints: one safetensors file with JSON in its header, whole or absent."""

import json
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors import numpy as safetensors_numpy

from pipeline.errors import PolicyError
from pipeline.files import atomic

type Curve = list[tuple[int, float]]
"""(step, loss) pairs."""

untyped: Any = safetensors_numpy
"""Its arrays have no element types."""

VECTORS = ("weights", "first", "second")
"""The optimiser's vectors, shape (parameters,) each."""

RETRAIN = "delete it and train again: the same seed gives the same policy"


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a training stands; the batches of a step follow from the seed and the step alone."""

    step: int
    """Updates done."""
    window: float
    """Sum of the losses since the last point of the training curve."""
    train_loss: Curve
    held_out_loss: Curve
    vectors: Mapping[str, NDArray[np.float32]]
    """One for each of VECTORS."""


def save_progress(folder: Path, identity: str, progress: Progress) -> Path:
    """Write a checkpoint and drop older ones; a kill at any point leaves the newest whole one."""
    path = folder / f"step-{progress.step:07d}.safetensors"
    facts = {"identity": identity, "step": progress.step, "window": progress.window,
             "train_loss": progress.train_loss, "held_out_loss": progress.held_out_loss}
    return keep(path, progress.vectors, facts)


def keep(path: Path, arrays: Mapping[str, NDArray[Any]], facts: Mapping[str, Any]) -> Path:
    """Write arrays and JSON of a training, `step-*.safetensors`, and drop what else its folder has of that name."""
    with atomic(path) as stream:
        stream.write(untyped.save(dict(arrays), {"training": json.dumps(facts)}))
    for other in path.parent.glob("step-*.safetensors"):
        if other != path:
            other.unlink()
    return path


def unpacked(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """JSON and arrays that `keep` wrote; call within `readable`."""
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")  # safetensors: header length, JSON header, tensors
    arrays: dict[str, NDArray[Any]] = untyped.load(data)
    return json.loads(json.loads(data[8 : 8 + size])["__metadata__"]["training"]), arrays


@contextmanager
def readable(path: Path, mend: str) -> Generator[None]:
    """PolicyError with this mend for whatever a damaged checkpoint raises while it is taken apart."""
    try:
        yield
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise PolicyError(f"not a training checkpoint: {error}", where=path, mend=mend) from error


def newest(folder: Path) -> Path | None:
    """The checkpoint of the highest step in a folder, or None."""
    return max(folder.glob("step-*.safetensors"), default=None)


def load_progress(path: Path, identity: str, parameters: int) -> Progress:
    """Read a checkpoint of the training that `identity` names.

    Raises:
        PolicyError: the file is damaged, or belongs to another training.
    """
    with readable(path, RETRAIN):
        facts, vectors = unpacked(path)
        progress = Progress(facts["step"], facts["window"], [(s, v) for s, v in facts["train_loss"]],
                            [(s, v) for s, v in facts["held_out_loss"]], vectors)
    if facts.get("identity") != identity:
        raise PolicyError("checkpoint of another training (data, config, seed or network differ)",
                          where=path, mend=RETRAIN)
    if {name: vector.shape for name, vector in vectors.items()} != dict.fromkeys(VECTORS, (parameters,)):
        raise PolicyError("checkpoint of another network", where=path, mend=RETRAIN)
    return progress
