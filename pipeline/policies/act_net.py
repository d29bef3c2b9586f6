"""ACT as lerobot has it, with a backbone of a quarter of the channels that still is a ResNet18.

lerobot's ACT takes a whole ResNet18, which is more than two CPU cores can teach in minutes. What we train has the same
layers with `shrink` times fewer channels. For the checkpoint its weights are laid into the first channels of the whole
one, all others 0: the same function, and ACTPolicy.from_pretrained loads it. What was measured for a picture of 96x96,
one thread, forward and back: 52 samples a second with all channels, 146 with half, 410 with a quarter.

The backbone's norms never learn (FrozenBatchNorm2d) and there are no weights of ImageNet to go with them; so they take
the mean and deviation that a batch has in their place before training, and keep them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature  # pyright: ignore[reportMissingTypeStubs]
from lerobot.policies.act.configuration_act import ACTConfig  # pyright: ignore[reportMissingTypeStubs]
from lerobot.policies.act.modeling_act import ACTPolicy  # pyright: ignore[reportMissingTypeStubs]
from torch import Tensor, nn
from torchvision.ops.misc import FrozenBatchNorm2d  # pyright: ignore[reportMissingTypeStubs]

from pipeline.footage import FEATURE
from pipeline.frames import ACTION, STATE
from pipeline.policies.ensembling import DECAY
from pipeline.policies.network import Weights, array, tensor

HEAD = 32
"""Width of an attention head."""
WIDER = 2
"""Width of the feed-forward layers, in widths of the transformer."""
CHANNELS = 512
"""Of ResNet18's last layer."""
LEAST_VARIANCE = 1e-6
BACKBONE, PROJECTION = "model.backbone.", "model.encoder_img_feat_input_proj."


@dataclass(frozen=True, slots=True)
class ActShape:
    """What fixes the shapes of a policy's weights."""

    camera: str
    height: int
    width: int
    """Of its pictures [px]."""
    chunk: int
    """Actions predicted at once."""
    dim: int
    """Width of the transformer."""
    layers: int
    """Of its encoder."""
    shrink: int
    """How many times fewer channels than ResNet18 the backbone has."""

    @property
    def feature(self) -> str:
        """Name of the pictures in a dataset version."""
        return FEATURE + self.camera

    @property
    def heads(self) -> int:
        """Attention heads."""
        return max(1, self.dim // HEAD)


def act_config(shape: ActShape, learning_rate: float) -> ACTConfig:
    """The configuration of lerobot's policy: pictures and the robot's own state in, nothing of the cube."""
    return ACTConfig(
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (len(STATE),)),
                        shape.feature: PolicyFeature(FeatureType.VISUAL, (3, shape.height, shape.width))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (len(ACTION),))},
        chunk_size=shape.chunk, n_action_steps=1, temporal_ensemble_coeff=-DECAY,
        pretrained_backbone_weights=None, dim_model=shape.dim, n_heads=shape.heads,
        dim_feedforward=WIDER * shape.dim, n_encoder_layers=shape.layers, n_decoder_layers=1,
        use_vae=False,  # demonstrations of one expert have one mode
        dropout=0.0, optimizer_lr=learning_rate, optimizer_lr_backbone=learning_rate, device="cpu", push_to_hub=False)


def whole(shape: ActShape, learning_rate: float = 1e-3) -> ACTPolicy:
    """lerobot's own policy, all channels, weights drawn from torch's generator."""
    return ACTPolicy(act_config(shape, learning_rate))


def narrow(shape: ActShape) -> ACTPolicy:
    """The policy that is trained: lerobot's with a narrower backbone, weights drawn from torch's generator."""
    policy = whole(shape)
    model: Any = policy.model
    for name, part in list(model.backbone.named_modules()):
        if isinstance(part, nn.Conv2d):
            _put(model.backbone, name, _convolution(part, shape.shrink))
        elif isinstance(part, FrozenBatchNorm2d):
            kept: Any = part.weight
            _put(model.backbone, name, FrozenBatchNorm2d(len(kept) // shape.shrink))
    model.encoder_img_feat_input_proj = nn.Conv2d(CHANNELS // shape.shrink, shape.dim, 1)
    return policy


def _convolution(full: nn.Conv2d, shrink: int) -> nn.Conv2d:
    sees = full.in_channels if full.in_channels == 3 else full.in_channels // shrink
    made = nn.Conv2d(sees, full.out_channels // shrink, full.kernel_size,  # pyright: ignore[reportArgumentType]
                     full.stride, full.padding, bias=False)  # pyright: ignore[reportArgumentType]
    nn.init.kaiming_normal_(made.weight, mode="fan_out", nonlinearity="relu")
    return made


def _put(root: nn.Module, name: str, part: nn.Module) -> None:
    *path, last = name.split(".")
    for step in path:
        root = getattr(root, step)
    setattr(root, last, part)


@torch.no_grad()
def measure_norms(policy: ACTPolicy, pictures: Tensor) -> None:
    """Give every frozen norm of the backbone the mean and variance that it meets with these normalised pictures."""
    model: Any = policy.model

    def meet(norm: Any, values: tuple[Tensor]) -> None:
        norm.running_mean.copy_(values[0].mean((0, 2, 3)))
        norm.running_var.copy_(values[0].var((0, 2, 3), correction=0).clamp(LEAST_VARIANCE))

    hooks = [part.register_forward_pre_hook(meet) for part in model.backbone.modules()
             if isinstance(part, FrozenBatchNorm2d)]
    model.backbone(pictures)
    for hook in hooks:
        hook.remove()


def weights_of(policy: ACTPolicy) -> dict[str, np.ndarray[Any, np.dtype[np.float32]]]:
    """A copy of everything that was learnt or measured, by its name in lerobot's policy."""
    state: Mapping[str, Tensor] = policy.state_dict()
    return {name: array(value).copy() for name, value in state.items()}


def load(policy: ACTPolicy, weights: Weights) -> ACTPolicy:
    """Take over weights; a missing, unknown or misshapen one is an error of PyTorch."""
    policy.load_state_dict({name: tensor(np.array(value)) for name, value in weights.items()})
    policy.eval()
    return policy


def widened(weights: Weights, shape: ActShape) -> dict[str, np.ndarray[Any, np.dtype[np.float32]]]:
    """The same function in the shapes of a whole ResNet18: what we have no channels for is 0.

    A channel that gets 0 from every weight stays 0 through its norm (mean 0, variance 1, no shift), and what follows
    multiplies it by 0.
    """
    full: Mapping[str, Tensor] = whole(shape).state_dict()
    found: dict[str, np.ndarray[Any, np.dtype[np.float32]]] = {}
    for name, values in weights.items():
        target = np.zeros(tuple(full[name].shape), np.float32)
        if name.startswith(BACKBONE) and name.endswith(("running_var", ".weight")) and values.ndim == 1:
            target[:] = 1.0
        target[tuple(slice(size) for size in values.shape)] = values
        found[name] = target
    return found
