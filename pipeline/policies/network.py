"""The network: relative features, a multilayer perceptron, a chunk of actions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from pipeline.frames import ACTION
from pipeline.policies.features import WIDTHS, matrix

type Weights = Mapping[str, NDArray[np.float32]]
"""Name in the network -> array."""


def tensor(array: NDArray[Any]) -> Tensor:
    """A tensor on the memory of an array."""
    return torch.from_numpy(array)  # pyright: ignore[reportUnknownMemberType]


def array(values: Tensor) -> NDArray[np.float32]:
    """An array on the memory of a tensor."""
    return np.asarray(values.detach().numpy(), np.float32)  # pyright: ignore[reportUnknownMemberType]


@dataclass(frozen=True, slots=True)
class Shape:
    """What fixes the shapes of a network's weights."""

    chunk: int
    """Actions predicted at once."""
    width: int
    depth: int
    """Hidden layers."""


class ChunkedNet(nn.Module):
    """Observation -> normalised actions of this tick and the next chunk - 1.

    Linear, LayerNorm and GELU, `depth` times, then a linear layer. The features are computed inside,
    so whoever runs the network hands over observations as they are.
    """

    matrix: Tensor
    feature_mean: Tensor
    feature_std: Tensor

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.shape = shape
        features, layers = sum(WIDTHS), list[nn.Module]()
        for n_in in (features, *[shape.width] * (shape.depth - 1)):
            layers += [nn.Linear(n_in, shape.width), nn.LayerNorm(shape.width), nn.GELU()]
        self.layers = nn.Sequential(*layers, nn.Linear(shape.width, shape.chunk * len(ACTION)))
        self.register_buffer("matrix", tensor(matrix()), persistent=False)
        self.register_buffer("feature_mean", torch.zeros(features))
        self.register_buffer("feature_std", torch.ones(features))

    def features(self, state: Tensor, environment: Tensor) -> Tensor:
        """Features (n, k) of state (n, 16) and environment (n, 7), not yet normalised."""
        differences = torch.cat((state, environment), 1) @ self.matrix
        linear, tanh, sin, cos = torch.split(differences, list(WIDTHS), 1)  # pyright: ignore[reportUnknownMemberType]
        return torch.cat((linear, tanh.tanh(), sin.sin(), cos.cos()), 1)

    def normalised(self, state: Tensor, environment: Tensor) -> Tensor:
        """Features with the training set's mean taken off, over its standard deviation."""
        return (self.features(state, environment) - self.feature_mean) / self.feature_std

    def forward(self, state: Tensor, environment: Tensor) -> Tensor:
        """Normalised chunk (n, chunk, 5) of state (n, 16) and environment (n, 7)."""
        return self.layers(self.normalised(state, environment)).unflatten(1, (self.shape.chunk, len(ACTION)))

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """A copy of everything that was learnt or measured, by name."""
        return {name: array(value).copy() for name, value in self.state_dict().items()}

    def load(self, weights: Weights) -> "ChunkedNet":
        """Take over weights; a missing, unknown or misshapen one is an error of PyTorch."""
        self.load_state_dict({name: tensor(np.array(value)) for name, value in weights.items()})
        return self

    def draw(self, rng: np.random.Generator) -> "ChunkedNet":
        """Fresh weights: uniform within 1 / sqrt(inputs), PyTorch's own default, from our generator."""
        for layer in self.layers:
            if isinstance(layer, nn.Linear):
                bound = layer.in_features**-0.5
                for parameter in (layer.weight, layer.bias):
                    drawn = rng.uniform(-bound, bound, tuple(parameter.shape)).astype(np.float32)
                    parameter.data.copy_(tensor(drawn))
        return self
