"""Resumable training checkpoints: one safetensors file with JSON in its header, whole or absent."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save  # pyright: ignore[reportUnknownVariableType]

from pipeline.errors import PolicyError
from pipeline.files import atomic

type Curve = list[tuple[int, float]]
"""(step, loss) pairs."""

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
    """weights, first and second: the optimiser's vectors, shape (parameters,) each."""


def save_progress(folder: Path, identity: str, progress: Progress) -> Path:
    """Write a checkpoint and drop older ones; a kill at any point leaves the newest whole one."""
    path = folder / f"step-{progress.step:07d}.safetensors"
    facts = {"identity": identity, "step": progress.step, "window": progress.window,
             "train_loss": progress.train_loss, "held_out_loss": progress.held_out_loss}
    with atomic(path) as stream:
        stream.write(save(dict(progress.vectors), {"training": json.dumps(facts)}))
    for other in folder.glob("step-*.safetensors"):
        if other != path:
            other.unlink()
    return path


def newest(folder: Path) -> Path | None:
    """The checkpoint of the highest step in a folder, or None."""
    return max(folder.glob("step-*.safetensors"), default=None)


def load_progress(path: Path, identity: str, parameters: int) -> Progress:
    """Read a checkpoint of the training that `identity` names.

    Raises:
        PolicyError: the file is damaged, or belongs to another training.
    """
    try:
        data = path.read_bytes()
        vectors = load(data)
        size = int.from_bytes(data[:8], "little")  # safetensors: header length, JSON header, tensors
        facts = json.loads(json.loads(data[8 : 8 + size])["__metadata__"]["training"])
        progress = Progress(facts["step"], facts["window"], [(s, v) for s, v in facts["train_loss"]],
                            [(s, v) for s, v in facts["held_out_loss"]], vectors)
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
        raise PolicyError(f"not a training checkpoint: {error}", where=path, mend=RETRAIN) from error
    if facts.get("identity") != identity:
        raise PolicyError("checkpoint of another training (data, config, seed or network differ)",
                          where=path, mend=RETRAIN)
    if {k: v.shape for k, v in vectors.items()} != dict.fromkeys(("weights", "first", "second"), (parameters,)):
        raise PolicyError("checkpoint of another network", where=path, mend=RETRAIN)
    return progress
