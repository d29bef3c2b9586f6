"""Exact statistics of pictures: every pixel of every frame counts, by way of one histogram a channel.

A pixel has 256 values, so that counts say all: minimum, mean, deviation and any quantile of an episode follow
from its histogram, and those of a whole version from the sum. They are of the pictures as the encoder got them.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.footage import Picture
from pipeline.lerobot_view.exact import MEASURES, QUANTILES

type Histogram = NDArray[np.int64]
"""Pixels by channel and value, shape (3, 256)."""


def empty() -> Histogram:
    """No pixel."""
    return np.zeros((3, 256), np.int64)


def counted(pictures: Iterable[Picture], into: Histogram) -> Iterator[Picture]:
    """Hand pictures on and count their pixels; a picture that comes again at once is not counted anew, but doubled."""
    from PIL import Image

    last, held = None, empty()
    for picture in pictures:
        if picture is not last:
            last, held = picture, np.array(Image.fromarray(picture).histogram()).reshape(3, 256)
        into += held
        yield picture


def measure(histogram: Histogram) -> NDArray[np.float64]:
    """MEASURES of each channel over at least one pixel, shape (len(MEASURES), 3), in [0, 1] as lerobot gives pictures.

    The deviation is that of the population; quantiles interpolate linearly between the two neighbouring order
    statistics, as in pipeline.lerobot_view.exact.
    """
    values = np.arange(256)
    pixels = histogram.sum(axis=1)
    result = np.empty((len(MEASURES), 3))
    for channel, counts in enumerate(histogram):
        there, until, total = np.flatnonzero(counts), np.cumsum(counts), int(pixels[channel])
        first, second = int(counts @ values), int(counts @ values**2)
        result[:4, channel] = (there[0], there[-1], first / total,
                               np.sqrt((second * total - first * first) / total**2))  # exact: Python's integers
        for row, share in enumerate(QUANTILES.values(), start=4):
            place = share * (total - 1)
            below = int(place)
            low, high = np.searchsorted(until, [below, min(below + 1, total - 1)], "right")
            result[row, channel] = low + (high - low) * (place - below)
    return result / 255


def for_stats(measures: NDArray[np.float64], frames: int) -> dict[str, object]:
    """One picture feature of stats.json: every measure of shape (3, 1, 1), and how many frames were counted."""
    told: dict[str, object] = {name: values.reshape(3, 1, 1).tolist()
                               for name, values in zip(MEASURES, measures, strict=True)}
    return told | {"count": [frames]}
