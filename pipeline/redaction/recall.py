"""How small a face the detector still finds: 100 faces and 100 other pictures of 25x25 that come with scikit-image."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.footage import Picture
from pipeline.redaction.detector import FIRST, SECOND, Detector

WIDTH, HEIGHT = 128, 96
"""Of the picture that a face is pasted into [px]."""


@dataclass(frozen=True, slots=True)
class Recall:
    """Of faces with one size."""

    edge: int
    """[px]"""
    faces: int
    first: int
    """Of these the first look found."""
    either: int
    """Of these one of both looks found."""
    others: int
    """Pictures of something else."""
    mistaken: int
    """Of these one of both looks took for a face."""


def recall(eyes: Detector, edge: int, threshold: float) -> Recall:
    """Paste each picture, scaled to `edge`, into a grey one of 128x96 and look for it.

    Source: Labeled Faces in the Wild (Huang et al. 2007), the subset `skimage.data.lfw_subset`: grey, cropped tightly.
    """
    from skimage import data  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

    cut = cast(NDArray[np.float64], cast(Any, data).lfw_subset())
    found = np.array([_found(eyes, _pasted(one, edge), threshold) for one in cut])
    faces, others = found[:100], found[100:]
    return Recall(edge, len(faces), int(faces[:, 0].sum()), int(faces.any(1).sum()), len(others),
                  int(others.any(1).sum()))


def _pasted(cut: NDArray[np.float64], edge: int) -> Picture:
    from PIL import Image

    small = Image.fromarray((cut * 255).astype(np.uint8)).resize((edge, edge), Image.Resampling.BILINEAR)
    picture = np.full((HEIGHT, WIDTH, 3), 110, np.uint8)
    picture[30:30 + edge, 40:40 + edge] = np.asarray(small)[:, :, None]
    return picture


def _found(eyes: Detector, picture: Picture, threshold: float) -> list[bool]:
    return [bool(eyes.faces(picture, look, threshold)) for look in (FIRST, SECOND)]
