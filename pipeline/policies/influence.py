"""Influence: how much more often a policy would succeed if a training sample weighed more.

In the manner of CUPID (Agia et al. 2025, "CUPID: Curating Data your Robot Loves with Influence Functions",
arXiv:2506.19121): the performance influence of a demonstration is the sum over its samples z of

    -g' H^-1 grad loss(z),     g = gradient of the expected return by the policy's weights,

with H the Gauss-Newton matrix of the training loss (Koh and Liang 2017, arXiv:1703.04730). CUPID projects gradients
at random (TRAK) because its policies are large. This one is small, so nothing is projected: g is one backward pass over
attempts with known noise (pipeline.worth.practice), v = H^-1 g comes from conjugate gradients, and v' grad loss(z) of
all samples at once from one forward-mode derivative along v. An action is a mean over overlapping chunks, so a chunk
answers for its share of the actions to come.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.func import functional_call, jvp, vjp  # pyright: ignore[reportUnknownVariableType]

from pipeline.policies.ensembling import DECAY, weights
from pipeline.policies.network import array, tensor
from pipeline.policies.source import Batch, TrainingSource
from pipeline.policies.training import Fitted

type F32 = NDArray[np.float32]
type Parameters = dict[str, Tensor]
type Product = Callable[[Tensor], Tensor]

CURVATURE_ROWS, ITERATIONS = 2048, 40
BLOCK = 8192
"""Samples whose influence is computed at once."""


@dataclass(frozen=True, slots=True)
class Tried:
    """What a policy did in attempts with noise, one row an action, and how each attempt ended."""

    state: F32
    """Shape (n, 16)."""
    environment: F32
    """Shape (n, 7)."""
    noise: F32
    """Standard normal, shape (n, 5)."""
    attempt: NDArray[np.intp]
    """Rows of an attempt stand together, in order of time, shape (n,)."""
    advantage: F32
    """Of each attempt: outcome minus what was to be expected, over the size of the noise and the attempts."""


class Influence:
    """The direction in which a policy would gain, and what training samples push along it.

    Args:
        fitted: the policy.
        tried: its attempts.
        data: what it was trained on, for the curvature of the loss.
        seed: of the samples that stand for the curvature.
    """

    def __init__(self, fitted: Fitted, tried: Tried, data: TrainingSource, *, seed: int = 0) -> None:
        self._fitted, self._net = fitted, fitted.network()
        self._names = {name: p.detach() for name, p in self._net.layers.named_parameters()}
        gain = self._gain(tried)
        chosen = data.sample(np.random.default_rng([43, seed]), CURVATURE_ROWS, fitted.shape.chunk)
        product = self._curvature(chosen, seed)
        self.direction = self._split(conjugate_gradient(product, gain))

    def of(self, batch: Batch) -> NDArray[np.float64]:
        """Influence of each sample of a batch on the expected success, shape (b,); only their order means something."""
        found: list[NDArray[np.float64]] = []
        state, environment, actions, mask = batch
        for start in range(0, len(state), BLOCK):
            some = slice(start, start + BLOCK)
            features, target, keep = self._tensors((state[some], environment[some], actions[some], mask[some]))
            out, along = self._along(features, self.direction)
            slope = (out - target).clamp(-1, 1) * keep  # derivative of the smooth L1
            found.append(-array((slope * along).sum(1)).astype(np.float64))
        return np.concatenate(found)

    def _gain(self, tried: Tried) -> Tensor:
        """Gradient of the expected return, flat."""
        with torch.no_grad():
            features = self._net.normalised(tensor(tried.state), tensor(tried.environment))
        pull = tensor(shares_of(tried, self._fitted.shape.chunk).reshape(len(tried.state), -1))
        return self._back(features, pull)

    def _curvature(self, batch: Batch, seed: int) -> Product:
        """v -> (H + damping) v; the damping is the mean eigenvalue, by one random probe (Hutchinson 1990)."""
        features, target, keep = self._tensors(batch)

        with torch.no_grad():
            bent = keep * ((self._run(self._names, features) - target).abs() < 1) / keep.sum()

        def product(v: Tensor) -> Tensor:
            return self._back(features, bent * self._along(features, self._split(v))[1])

        size = sum(p.numel() for p in self._names.values())
        probe = tensor(np.random.default_rng([47, seed]).choice([-1.0, 1.0], size).astype(np.float32))
        damping = float(probe @ product(probe)) / size
        return lambda v: product(v) + damping * v

    def _run(self, p: Parameters, features: Tensor) -> Tensor:
        """What the network makes of features with these weights, shape (n, chunk * 5)."""
        return functional_call(self._net.layers, p, (features,))

    def _along(self, features: Tensor, direction: Parameters) -> tuple[Tensor, Tensor]:
        """What the network makes of features, and how that changes along a direction of its weights."""
        def network(p: Parameters) -> Tensor:
            return self._run(p, features)

        found: Any = jvp(network, (self._names,), (direction,))
        return found[0], found[1]

    def _back(self, features: Tensor, pull: Tensor) -> Tensor:
        """The gradient by the weights of sum(pull x what the network makes of features), flat."""
        def network(p: Parameters) -> Tensor:
            return self._run(p, features)

        found: Any = vjp(network, self._names)
        return _flat(found[1](pull)[0])

    def _tensors(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        """Normalised features, normalised actions with padding 0, and the mask, as training sees them."""
        state, environment, actions, mask = batch
        keep = np.repeat(mask.astype(np.float32), actions.shape[2], 1)
        target = ((actions - self._fitted.action_mean) / self._fitted.action_std).reshape(keep.shape) * keep
        with torch.no_grad():
            features = self._net.normalised(tensor(state), tensor(environment))
        return features, tensor(target.astype(np.float32)), tensor(keep)

    def _split(self, flat: Tensor) -> Parameters:
        parts: dict[str, Tensor] = {}
        start = 0
        for name, p in self._names.items():
            parts[name] = flat[start:start + p.numel()].view_as(p)
            start += p.numel()
        return parts


def shares_of(tried: Tried, chunk: int) -> F32:
    """What each prediction of each chunk has to do with the outcome: advantage x noise x its share of the action.

    Row t's chunk predicts the actions of rows t, t + 1, ... of its attempt; the action of a row is the mean of all
    predictions of it, weighed by their age. Shape (n, chunk, 5).
    """
    n, out = len(tried.state), np.zeros((len(tried.state), chunk, tried.noise.shape[1]), np.float32)
    first = np.flatnonzero(np.diff(tried.attempt, prepend=-1))
    tick = np.arange(n) - np.repeat(first, np.diff(np.append(first, n)))
    weigh = weights(chunk, DECAY)
    whole = np.cumsum(weigh)
    told = tried.noise * tried.advantage[tried.attempt][:, None] / whole[np.minimum(tick, chunk - 1), None]
    for age in range(chunk):
        acts = np.flatnonzero(tick >= age)
        out[acts - age, age] = weigh[age] * told[acts]
    return out


def conjugate_gradient(product: Product, b: Tensor, iterations: int = ITERATIONS) -> Tensor:
    """x with A x = b for a symmetric positive A given by its products (Hestenes and Stiefel 1952)."""
    x, r = torch.zeros_like(b), b.clone()
    p, size = r.clone(), float(r @ r)
    for _ in range(iterations):
        if size <= 1e-12 * float(b @ b):
            break
        along = product(p)
        step = size / float(p @ along)
        x += step * p
        r -= step * along
        before, size = size, float(r @ r)
        p = r + (size / before) * p
    return x


def _flat(parts: Parameters) -> Tensor:
    return torch.cat([part.reshape(-1) for part in parts.values()])
