"""The checkpoint folder: what lerobot's own `save_pretrained` would write, without importing lerobot.

Importing lerobot costs two seconds and 340 MB that a loop does not need; a test holds these bytes against
lerobot's own, file by file. No pickle: JSON and safetensors.
"""

import json
from pathlib import Path

from safetensors.numpy import save  # pyright: ignore[reportUnknownVariableType]

from pipeline.errors import PolicyError
from pipeline.files import atomic
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.policies.ensembling import DECAY
from pipeline.policies.training import Fitted
from schemas.recipe import TrainConfig

type Json = dict[str, object]

INPUT: Json = {
    "observation.state": {"type": "STATE", "shape": [len(STATE)]},
    "observation.environment_state": {"type": "ENV", "shape": [len(ENVIRONMENT)]},
}
OUTPUT: Json = {"action": {"type": "ACTION", "shape": [len(ACTION)]}}
NORMS: Json = {"STATE": "IDENTITY", "ENV": "IDENTITY", "ACTION": "MEAN_STD"}
DEVICE: Json = {"registry_name": "device_processor", "config": {"device": "cpu", "float_dtype": None}}
BEFORE, AFTER = "policy_preprocessor", "policy_postprocessor"


def _config(fitted: Fitted, learning_rate: float) -> Json:
    return {
        "type": "chunked", "n_obs_steps": 1, "input_features": INPUT, "output_features": OUTPUT, "device": "cpu",
        "use_amp": False, "use_peft": False, "push_to_hub": False, "repo_id": None, "private": None, "tags": None,
        "license": None, "pretrained_path": None, "pretrained_revision": None,
        "chunk": fitted.shape.chunk, "width": fitted.shape.width, "depth": fitted.shape.depth,
        "ensemble_decay": DECAY, "learning_rate": learning_rate, "normalization_mapping": NORMS,
    }


def _normaliser(pipeline: str, step: int, name: str, features: Json) -> Json:
    return {"registry_name": name, "config": {"eps": 1e-8, "features": features, "norm_map": NORMS},
            "state_file": f"{pipeline}_step_{step}_{name}.safetensors"}


def checkpoint_files(fitted: Fitted, config: TrainConfig) -> dict[str, bytes]:
    """File name -> bytes of a lerobot checkpoint."""
    before = _normaliser(BEFORE, 3, "normalizer_processor", {**INPUT, **OUTPUT})
    after = _normaliser(AFTER, 0, "unnormalizer_processor", OUTPUT)
    rename: Json = {"registry_name": "rename_observations_processor", "config": {"rename_map": {}}}
    batch: Json = {"registry_name": "to_batch_processor", "config": {}}
    statistics = save({"action.mean": fitted.action_mean, "action.std": fitted.action_std})
    return {
        "config.json": json.dumps(_config(fitted, config.learning_rate), indent=4).encode(),
        "model.safetensors": save({f"net.{name}": weights for name, weights in fitted.weights.items()}),
        f"{BEFORE}.json": json.dumps({"name": BEFORE, "steps": [rename, batch, DEVICE, before]}, indent=2).encode(),
        f"{AFTER}.json": json.dumps({"name": AFTER, "steps": [after, DEVICE]}, indent=2).encode(),
        str(before["state_file"]): statistics,
        str(after["state_file"]): statistics,
    }


def write_checkpoint(folder: Path, fitted: Fitted, config: TrainConfig) -> None:
    """Write a checkpoint that `lerobot-eval --policy.path=FOLDER` takes.

    Raises:
        PolicyError: the folder holds a checkpoint already; policies never change.
    """
    if (folder / "config.json").exists():
        raise PolicyError("a checkpoint is there already", where=folder, mend="write to another folder")
    for name, data in checkpoint_files(fitted, config).items():
        with atomic(folder / name) as stream:
            stream.write(data)
