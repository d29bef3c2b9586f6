"""Course: where a training stands, its loss curves, and the way back to a checkpoint of it."""

import math
from collections.abc import Callable
from pathlib import Path

import torch

from pipeline.errors import PolicyError
from pipeline.policies.network import array, tensor
from pipeline.policies.optimiser import FlatAdamW, one_cycle
from pipeline.policies.resuming import VECTORS, Curve, Progress, load_progress
from schemas.recipe import TrainConfig

POINTS = 15
"""Points of the loss curves."""


class Course:
    """Steps done and losses seen; the base of what trains one kind of policy.

    Args:
        config: steps and learning rate.
        optimiser: of all that is trained.
        identity: what a checkpoint must have been written for.
        held_out: the loss on the validation split now; None where that is empty.
    """

    def __init__(self, config: TrainConfig, optimiser: FlatAdamW, identity: str,
                 held_out: Callable[[], float] | None) -> None:
        self.config, self.optimiser, self.identity, self._held_out = config, optimiser, identity, held_out
        self.step, self.window = 0, 0.0
        self.train_loss: Curve = []
        self.held_out_loss: Curve = []

    def advance(self, loss: float) -> None:
        """Let the optimiser take the step whose loss and gradient are known; a point of the curves where one is due.

        Raises:
            PolicyError: the losses are no longer finite.
        """
        self.optimiser.step(self.step, one_cycle(self.step, self.config.steps, self.config.learning_rate))
        self.window += loss
        self.step += 1
        every = max(1, self.config.steps // POINTS)
        if self.step % every:
            return
        if not math.isfinite(self.window):
            raise PolicyError(f"training diverged before step {self.step}",
                              where=f"learning_rate {self.config.learning_rate}", mend="lower train.learning_rate")
        self.train_loss.append((self.step, self.window / every))
        self.window = 0.0
        if self._held_out is not None:
            with torch.no_grad():
                self.held_out_loss.append((self.step, self._held_out()))

    @property
    def last_loss(self) -> float:
        """The newest point of the training curve; NaN before the first."""
        return self.train_loss[-1][1] if self.train_loss else math.nan

    def progress(self) -> Progress:
        """What a checkpoint holds."""
        vectors = {name: array(getattr(self.optimiser, name)) for name in VECTORS}
        return Progress(self.step, self.window, self.train_loss, self.held_out_loss, vectors)

    def resume(self, path: Path) -> None:
        """Go back to where a checkpoint stands."""
        saved = load_progress(path, self.identity, self.optimiser.weights.numel())
        for name, vector in saved.vectors.items():
            getattr(self.optimiser, name).copy_(tensor(vector))
        self.step, self.window = saved.step, saved.window
        self.train_loss, self.held_out_loss = saved.train_loss, saved.held_out_loss
