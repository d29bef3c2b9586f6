"""Distance to the training data: how far a robot is from everything that its policy has been shown.

The space is that of the policy's own features (pipeline.policies.features), each over its standard deviation in the
training data. Distances come from one product of matrices in blocks: in 32 dimensions a tree has nothing to leave out.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pipeline.policies.features import WIDTHS, matrix
from pipeline.protocols import Observation

type F32 = NDArray[np.float32]

KEPT = 4000
"""Training frames that are kept, evenly drawn. AUROC of the first 40 ticks on twins 0-7, for the two champions of
docs/results.md: .974 and .878 with 2,000 frames, .978 and .891 with 4,000, .982 and .904 with 16,000, which take 4
times as long."""
NEAREST = 5
"""Neighbours whose distances are averaged."""
_ROWS = 256
"""Observations worked on at once: the table of distances stays within the cache."""
_DRAW = 0x51D
"""Seed of the draw of frames: the same version always gives the same index."""


def in_feature_space(state: NDArray[np.floating], environment: NDArray[np.floating]) -> F32:
    """What a policy's network is told of observations, shape (n, 32), not yet normalised.

    Args:
        state: see pipeline.frames.STATE, shape (n, 16).
        environment: see pipeline.frames.ENVIRONMENT, shape (n, 7).
    """
    observed = np.concatenate([state, environment], axis=1, dtype=np.float32)
    linear, tanh, sin, cos = np.split(observed @ matrix(), np.cumsum(WIDTHS)[:-1], axis=1)
    return np.concatenate([linear, np.tanh(tanh), np.sin(sin), np.cos(cos)], axis=1)


@dataclass(frozen=True, slots=True)
class Neighbours:
    """Frames that a policy learnt from, ready to be asked for the nearest."""

    frames: F32
    """Normalised features, shape (k, 32)."""
    squares: F32
    """Squared length of each, shape (k,)."""
    mean: F32
    scale: F32
    """Standard deviation of each feature over the training frames, 1 where it never changes."""

    @classmethod
    def among(cls, state: F32, environment: F32, *, kept: int = KEPT) -> Self:
        """An index of frames.

        Args:
            state, environment: frames that teach, shape (n, 16) and (n, 7), n >= 1.
            kept: how many to keep at most.
        """
        features = in_feature_space(state, environment)
        mean, scale = features.mean(axis=0), features.std(axis=0)
        scale[scale < 1e-6] = 1.0
        pick = np.random.default_rng(_DRAW).choice(len(features), min(kept, len(features)), replace=False)
        frames = (features[np.sort(pick)] - mean) / scale
        return cls(frames, (frames**2).sum(axis=1), mean, scale)

    def distance(self, observation: Observation) -> NDArray[np.float64]:
        """Mean distance to the nearest frames [standard deviations of a feature], shape (n,)."""
        asked = (in_feature_space(observation.state, observation.environment) - self.mean) / self.scale
        count, found = min(NEAREST, len(self.frames)), np.empty(len(asked))
        for at in range(0, len(asked), _ROWS):
            rows = asked[at:at + _ROWS]
            squared = (rows**2).sum(axis=1)[:, None] - 2 * rows @ self.frames.T + self.squares
            nearest = self.frames[np.argpartition(squared, count - 1, axis=1)[:, :count]]
            apart = rows[:, None].astype(np.float64) - nearest  # again, exactly: a product's last bits are the BLAS's
            found[at:at + _ROWS] = np.sqrt((apart**2).sum(axis=2)).mean(axis=1)
        return found
