"""AdamW with a one-cycle learning rate, on one flat vector: few, large operations and a state that saves whole."""

import math
from collections.abc import Sequence

import torch
from torch import nn

FIRST, SECOND = 0.9, 0.999
"""Decay of the first and second moment."""
EPS, WEIGHT_DECAY = 1e-8, 0.01
"""PyTorch's own defaults for AdamW."""
WARM, START, END = 0.3, 1 / 25, 1 / 25e4
"""Share of the steps spent rising, first and last rate as shares of the peak (PyTorch's OneCycleLR)."""


def one_cycle(step: int, steps: int, peak: float) -> float:
    """Learning rate of a step in [0, steps): a cosine up to the peak, a cosine down to nearly nothing.

    Source: L. Smith and N. Topin, "Super-convergence", 2018; the shape is that of torch's OneCycleLR.
    """
    top = max(1.0, WARM * steps - 1)
    if step <= top:
        low, high, way = START * peak, peak, step / top
    else:
        low, high, way = peak, END * peak, (step - top) / max(1.0, steps - 1 - top)
    return low + (high - low) * (1 - math.cos(math.pi * way)) / 2


class FlatAdamW:
    """Decoupled weight decay Adam over all parameters as one vector.

    The parameters and their gradients become views of two vectors, so that a step is seven operations
    however many layers there are, and `weights`, `first` and `second` are the whole state.

    Source: I. Loshchilov and F. Hutter, "Decoupled weight decay regularization", 2019, algorithm 2.
    """

    def __init__(self, parameters: Sequence[nn.Parameter]) -> None:
        self.weights = torch.cat([p.detach().reshape(-1) for p in parameters])
        self.gradient = torch.zeros_like(self.weights)
        self.first, self.second = torch.zeros_like(self.weights), torch.zeros_like(self.weights)
        self._scratch = torch.empty_like(self.weights)
        start = 0
        for p in parameters:
            part = slice(start, start + p.numel())
            p.data, p.grad = self.weights[part].view_as(p), self.gradient[part].view_as(p)
            start += p.numel()

    @torch.no_grad()
    def step(self, number: int, rate: float) -> None:
        """Update the weights by the gradients, as update `number` (from 0), and clear the gradients."""
        self.first.lerp_(self.gradient, 1 - FIRST)
        self.second.mul_(SECOND).addcmul_(self.gradient, self.gradient, value=1 - SECOND)
        torch.sqrt(self.second, out=self._scratch)
        self._scratch.mul_((1 - SECOND ** (number + 1)) ** -0.5).add_(EPS)
        self.weights.mul_(1 - rate * WEIGHT_DECAY)
        self.weights.addcdiv_(self.first, self._scratch, value=-rate / (1 - FIRST ** (number + 1)))
        self.gradient.zero_()
