"""Exact statistics of features: every value counts, quantiles are those of the whole column.

lerobot's own quantiles are averages of per-episode histograms; a normaliser built on them is off by
whatever the episodes differ in.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import FEATURES, Features
from pipeline.lerobot_view.layout import widths

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
MEASURES = ("min", "max", "mean", "std", *QUANTILES)
"""Rows of a statistics array; `count`, the number of frames, is kept beside it."""


def as_matrix(columns: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    """All features below each other, shape (values, n): value 0 of the first feature is row 0."""
    matrix = np.empty((sum(values.shape[1] for values in columns.values()), len(next(iter(columns.values())))))
    row = 0
    for values in columns.values():
        matrix[row:row + values.shape[1]] = values.T
        row += values.shape[1]
    return matrix


def measure(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """MEASURES of every row over n >= 1 frames, shape (values, n) -> (len(MEASURES), values).

    The deviation is that of the population (divided by n), as in lerobot. Quantiles interpolate
    linearly between the two neighbouring order statistics (Hyndman and Fan 1996, definition 7).
    """
    ordered = np.sort(matrix, axis=1)
    result = np.empty((len(MEASURES), len(matrix)))
    result[:2] = ordered[:, 0], ordered[:, -1]
    result[2], result[3] = matrix.mean(axis=1), matrix.std(axis=1)
    for row, share in enumerate(QUANTILES.values(), start=4):
        place = share * (matrix.shape[1] - 1)
        below = int(place)
        low, high = ordered[:, below], ordered[:, min(below + 1, matrix.shape[1] - 1)]
        result[row] = low + (high - low) * (place - below)
    return result


def by_feature(measures: NDArray[np.float64], frames: int, of: Features = FEATURES,
               ) -> dict[str, dict[str, list[float] | list[int]]]:
    """Feature -> measure -> one number a value, as stats.json holds it."""
    return by_width(measures, frames, widths(of))


def by_width(measures: NDArray[np.float64], frames: int, width_of: Mapping[str, int],
             ) -> dict[str, dict[str, list[float] | list[int]]]:
    """The same for features that are known by how many values they have, in their order."""
    result: dict[str, dict[str, list[float] | list[int]]] = {}
    row = 0
    for name, width in width_of.items():
        values = measures[:, row:row + width].tolist()
        result[name] = {**dict(zip(MEASURES, values, strict=True)), "count": [frames]}
        row += width
    return result
