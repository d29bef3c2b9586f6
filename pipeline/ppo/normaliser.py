"""Normaliser: running mean and spread of what is observed, so that a network sees numbers near 1."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array

LEAST = 0.01
"""Smallest spread that is divided by: what hardly ever changes is not blown up."""


class Normaliser:
    """Mean and variance over all rows seen so far, by columns.

    Source: Chan, Golub, LeVeque 1983, The American Statistician 37:242, the pairwise update.
    """

    def __init__(self, width: int) -> None:
        self.mean, self.var, self.count = np.zeros(width), np.ones(width), 0.0

    def update(self, rows: NDArray[np.float32]) -> None:
        """Take these rows into account, shape (n, width)."""
        n, mean, var = len(rows), rows.mean(axis=0, dtype=np.float64), rows.var(axis=0, dtype=np.float64)
        total, apart = self.count + n, mean - self.mean
        self.var = (self.var * self.count + var * n + apart**2 * (self.count * n / total)) / total
        self.mean = self.mean + apart * (n / total)
        self.count = total

    @property
    def std(self) -> Array:
        """Spread of each column, at least LEAST."""
        return np.maximum(np.sqrt(self.var), LEAST)

    def __call__(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The rows in units of the spread about the mean."""
        return ((rows - self.mean) / self.std).astype(np.float32)

    def save(self) -> dict[str, Array]:
        """All of it, for a checkpoint."""
        return {"mean": self.mean.copy(), "var": self.var.copy(), "count": np.array([self.count])}

    def load(self, saved: Mapping[str, Array]) -> None:
        """Go on from what `save` gave."""
        self.mean, self.var = saved["mean"].copy(), saved["var"].copy()
        self.count = float(saved["count"][0])
