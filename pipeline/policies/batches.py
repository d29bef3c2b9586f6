"""Batches as lerobot's policies take them: those of a DataLoader over LeRobotDataset, out of memory."""

from collections.abc import Iterator
from typing import Protocol

import numpy as np
import torch

from pipeline.lerobot_view.augmenting import Augment
from pipeline.lerobot_view.samples import Arrays, Deltas

type LerobotBatch = dict[str, torch.Tensor | list[str]]


class SampleSource(Protocol):
    """One version, or several mixed: pipeline.lerobot_view.samples.Samples, mixing.Mixture."""

    def sample(self, rng: np.random.Generator, batch: int, deltas: Deltas, augment: Augment | None = None) -> Arrays:
        """A training batch."""
        ...

    def task_of(self, found: Arrays) -> list[str]:
        """What was asked of the robot in each sample, in words."""
        ...


def lerobot_batch(found: Arrays, tasks: list[str]) -> LerobotBatch:
    """A batch as torch's default collation makes it of items of LeRobotDataset; arrays are shared, not copied."""
    return {**{name: torch.as_tensor(values) for name, values in found.items()}, "task": tasks}


def batches(source: SampleSource, seed: int, batch: int, deltas: Deltas, augment: Augment | None = None, *,
            skip: int = 0) -> Iterator[LerobotBatch]:
    """Training batches without end; batch k follows from `seed` and k alone, so that a training can go on at any.

    Args:
        source: what to draw from.
        seed: decides every batch.
        batch: samples each.
        deltas: such as {"action": range(16)} for chunks of 16 actions.
        augment: changes pictures at random.
        skip: batches to leave out at the start.
    """
    number = skip
    while True:
        found = source.sample(np.random.default_rng((seed, number)), batch, deltas, augment)
        yield lerobot_batch(found, source.task_of(found))
        number += 1
