"""What training learns from: batches of frames with the actions that followed them."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

type F32 = NDArray[np.float32]
type Batch = tuple[F32, F32, F32, NDArray[np.bool_]]
"""state (b, 16), environment (b, 7), actions (b, chunk, 5) and mask (b, chunk), False where an episode has ended."""


class TrainingSource(Protocol):
    """A dataset version as training sees it; see pipeline.lerobot_view.training_data.TrainingData."""

    def sample(self, rng: np.random.Generator, batch: int, chunk: int) -> Batch:
        """Draw `batch` frames with their next `chunk` actions, sources by weight; equal generators, equal batches."""
        ...

    def held_out(self, chunk: int) -> Batch:
        """Every sample of the validation split; may be empty."""
        ...
