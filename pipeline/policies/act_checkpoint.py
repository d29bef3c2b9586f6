"""The checkpoint folder of ACT, by lerobot's own `save_pretrained`; no pickle: JSON and safetensors."""

from pathlib import Path
from typing import Any

from lerobot.policies.act.processor_act import (  # pyright: ignore[reportMissingTypeStubs]
    make_act_pre_post_processors,  # pyright: ignore[reportUnknownVariableType]
)

from pipeline.errors import PolicyError
from pipeline.policies.act_net import load, whole, widened
from pipeline.policies.act_training import FittedAct
from pipeline.policies.network import tensor
from schemas.recipe import TrainConfig

BYTE = 255.0
"""lerobot's pictures are in [0, 1]."""


def write_act(folder: Path, fitted: FittedAct, config: TrainConfig) -> None:
    """Write a checkpoint that `ACTPolicy.from_pretrained(FOLDER)` loads, with a whole ResNet18; see act_net.

    Raises:
        PolicyError: the folder holds a checkpoint already; policies never change.
    """
    if (folder / "config.json").exists():
        raise PolicyError("a checkpoint is there already", where=folder, mend="write to another folder")
    policy: Any = load(whole(fitted.shape, config.learning_rate), widened(fitted.weights, fitted.shape))
    s = fitted.scales
    pixels = (tensor(v[:, None, None] / BYTE) for v in (s.pixel_mean, s.pixel_std))
    statistics: Any = {name: {"mean": mean, "std": std} for name, (mean, std) in (
        (fitted.shape.feature, pixels), ("observation.state", (tensor(s.state_mean), tensor(s.state_std))),
        ("action", (tensor(s.action_mean), tensor(s.action_std))))}
    folder.mkdir(parents=True, exist_ok=True)
    policy.save_pretrained(folder)
    processor: Any
    for processor in make_act_pre_post_processors(policy.config, statistics):
        processor.save_pretrained(folder)
