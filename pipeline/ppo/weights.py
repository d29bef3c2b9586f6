"""Weights and normaliser of a training as one file: what another training may begin with.

The optimiser, the generators and the attempts stay behind: whoever goes on from weights begins a training of its own.
"""

# SB3 and torch are only partly typed
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors import numpy as safetensors_numpy
from stable_baselines3 import PPO

from pipeline.errors import PolicyError
from pipeline.files import atomic, sha256
from pipeline.ppo.normaliser import Normaliser

untyped: Any = safetensors_numpy
"""Its arrays have no element types."""

AGAIN = "name the policy that the training was ordered to go on from, or train one: hardcase train"


def write_weights(path: Path, weights: Mapping[str, NDArray[Any]], normaliser: Normaliser) -> str:
    """Write what another training may begin with; returns its hash, which an Order names.

    Args:
        path: a safetensors file.
        weights: SB3's names of an ActorCriticPolicy with an MLP -> values.
        normaliser: what the weights expect of observations.
    """
    arrays = {**{f"weights/{name}": values for name, values in weights.items()},
              **{f"normaliser/{name}": values for name, values in normaliser.save().items()}}
    data: bytes = untyped.save({name: np.ascontiguousarray(values) for name, values in sorted(arrays.items())})
    with atomic(path) as stream:
        stream.write(data)
    return sha256(data)


def begin_with(model: PPO, normaliser: Normaliser, path: Path | None, identity: str) -> None:
    """Put weights and normaliser of another training into one that has not begun; its optimiser stays fresh.

    Args:
        model, normaliser: of the training.
        path: a file of `write_weights`.
        identity: the file's hash.

    Raises:
        PolicyError: there is no file, it is damaged or another one, or its network has another shape.
    """
    if path is None:
        raise PolicyError("a training that goes on from weights was given none", where=f"weights {identity[:12]}",
                          mend=AGAIN)
    try:
        data = path.read_bytes()
        if (found := sha256(data)) != identity:
            raise PolicyError(f"weights {found[:12]} instead of {identity[:12]}", where=path, mend=AGAIN)
        arrays: dict[str, NDArray[Any]] = untyped.load(data)
        parts: dict[str, dict[str, NDArray[Any]]] = {"weights": {}, "normaliser": {}}
        for key, values in arrays.items():
            part, name = key.split("/", 1)
            parts[part][name] = values.copy()
        if parts["normaliser"]["mean"].shape != normaliser.mean.shape:
            raise ValueError(f"{len(parts['normaliser']['mean'])} values are sensed, not {len(normaliser.mean)}")
        model.policy.load_state_dict({k: torch.from_numpy(v) for k, v in parts["weights"].items()})
        normaliser.load(parts["normaliser"])
    except (OSError, SafetensorError, KeyError, ValueError, RuntimeError) as error:
        raise PolicyError(f"these weights cannot be gone on from: {str(error).splitlines()[0]}", where=path,
                          mend=AGAIN) from error
