"""The chunked policy as lerobot knows it: config, policy and processors.

This is the one file of ours with lerobot's `register_subclass` for policies; lerobot's command lines
reach it by `--policy.discover_packages_path=pipeline.policies`, or as lerobot_env.py says. lerobot's factory
looks for the policy class and the processors' maker in the module of the config class, so the three stand
together.
"""

from dataclasses import dataclass, field
from typing import Any, override

import numpy as np
import torch
import torch.nn.functional as F
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig  # pyright: ignore[reportMissingTypeStubs]
from lerobot.optim import AdamWConfig  # pyright: ignore[reportMissingTypeStubs]
from lerobot.policies.pretrained import PreTrainedPolicy  # pyright: ignore[reportMissingTypeStubs]
from lerobot.processor import PolicyProcessorPipeline, make_default_pre_post_processors  # pyright: ignore[reportMissingTypeStubs]
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE  # pyright: ignore[reportMissingTypeStubs]
from torch import Tensor

from pipeline import frames
from pipeline.policies.ensembling import DECAY, Ensembler
from pipeline.policies.network import ChunkedNet, Shape, array, tensor


@PreTrainedConfig.register_subclass("chunked")  # pyright: ignore[reportUnknownMemberType]
@dataclass
class ChunkedConfig(PreTrainedConfig):
    """A chunked multilayer perceptron on relative features of the state."""

    chunk: int = 16
    """Actions predicted at once."""
    width: int = 256
    depth: int = 2
    ensemble_decay: float = DECAY
    """See pipeline.policies.ensembling."""
    learning_rate: float = 1e-3

    device: str | None = "cpu"
    push_to_hub: bool = False
    input_features: dict[str, PolicyFeature] | None = field(default_factory=lambda: {
        OBS_STATE: PolicyFeature(FeatureType.STATE, (len(frames.STATE),)),
        OBS_ENV_STATE: PolicyFeature(FeatureType.ENV, (len(frames.ENVIRONMENT),)),
    })
    output_features: dict[str, PolicyFeature] | None = field(default_factory=lambda: {
        ACTION: PolicyFeature(FeatureType.ACTION, (len(frames.ACTION),)),
    })
    # Observations stay as they are: the network makes its features of metres and radians, then normalises those.
    normalization_mapping: dict[str, NormalizationMode] = field(default_factory=lambda: {
        "STATE": NormalizationMode.IDENTITY,
        "ENV": NormalizationMode.IDENTITY,
        "ACTION": NormalizationMode.MEAN_STD,
    })

    @property
    @override
    def observation_delta_indices(self) -> None:
        """Only the present observation."""

    @property
    @override
    def action_delta_indices(self) -> list[int]:
        """Actions of this tick and the next chunk - 1."""
        return list(range(self.chunk))

    @property
    @override
    def reward_delta_indices(self) -> None:
        """No rewards."""

    @override
    def get_optimizer_preset(self) -> AdamWConfig:
        """What lerobot-train uses unless told otherwise."""
        return AdamWConfig(lr=self.learning_rate)

    @override
    def get_scheduler_preset(self) -> None:
        """None: lerobot has no one-cycle schedule."""

    @override
    def validate_features(self) -> None:
        """Both observations and the action must have the robot's shapes."""
        want = {OBS_STATE: frames.STATE, OBS_ENV_STATE: frames.ENVIRONMENT, ACTION: frames.ACTION}
        have = {**(self.input_features or {}), **(self.output_features or {})}
        for name, names in want.items():
            if name not in have or tuple(have[name].shape) != (len(names),):
                raise ValueError(f"{name} must have shape ({len(names)},), the features are {have}")


class ChunkedPolicy(PreTrainedPolicy):
    """The network, its loss, and the memory that temporal ensembling needs."""

    config_class = ChunkedConfig  # pyright: ignore[reportAssignmentType, reportIncompatibleUnannotatedOverride]
    name = "chunked"  # pyright: ignore[reportAssignmentType, reportIncompatibleUnannotatedOverride]

    def __init__(self, config: ChunkedConfig, **_: Any) -> None:
        super().__init__(config)  # pyright: ignore[reportUnknownMemberType]
        config.validate_features()
        self.net = ChunkedNet(Shape(config.chunk, config.width, config.depth))
        self._ensembler = Ensembler(config.chunk, len(frames.ACTION), config.ensemble_decay)
        self._attempts: int | None = None

    @override
    def get_optim_params(self) -> Any:
        """Every parameter, alike."""
        return self.parameters()

    @override
    def reset(self) -> None:
        """Forget all chunks; the next observation says how many attempts there are."""
        self._attempts = None

    @override
    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, float] | None]:
        """Smooth L1 over the actions (n, chunk, 5) that are not padding (`action_is_pad`, (n, chunk))."""
        keep = torch.ones_like(batch[ACTION][..., :1])
        if "action_is_pad" in batch:
            keep = keep * ~batch["action_is_pad"][..., None]
        predicted = self.net(batch[OBS_STATE], batch[OBS_ENV_STATE])
        total = F.smooth_l1_loss(predicted * keep, batch[ACTION] * keep, reduction="sum")
        loss = total / (keep.sum() * predicted.shape[-1])
        return loss, {"smooth_l1": loss.item()}

    @override
    def predict_action_chunk(self, batch: dict[str, Tensor], **_: Any) -> Tensor:
        """Normalised chunk (n, chunk, 5) for the observations of n attempts."""
        self.eval()
        return self.net(batch[OBS_STATE], batch[OBS_ENV_STATE])

    @override
    def select_action(self, batch: dict[str, Tensor], **_: Any) -> Tensor:
        """Normalised actions (n, 5) of this tick, ensembled over the chunks since reset()."""
        with torch.inference_mode():
            chunk = self.predict_action_chunk(batch)
        if self._attempts != len(chunk):
            self._attempts = len(chunk)
            self._ensembler.reset(self._attempts)
        action = self._ensembler.step(array(chunk.cpu()), np.arange(len(chunk)))
        return tensor(action).to(chunk)


def make_chunked_pre_post_processors(
    config: ChunkedConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> tuple[PolicyProcessorPipeline[Any, Any], PolicyProcessorPipeline[Any, Any]]:
    """lerobot's default pipelines: batch, device, normalise; actions back to their units."""
    return make_default_pre_post_processors(config, dataset_stats, normalizer_device=config.device)
