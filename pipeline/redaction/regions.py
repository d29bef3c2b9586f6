"""Regions of pictures as masks, and their solid fill."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.footage import Picture
from schemas.redaction import CameraRule, Colour, Region

type Mask = NDArray[np.bool_]
"""True where a picture is hidden, shape (height, width)."""

type Box = tuple[float, float, float, float]
"""Left, top, right, bottom [px]; right and bottom are the first that lie outside."""


@dataclass(frozen=True)
class Regions:
    """The regions of one camera that count in one episode."""

    masks: Sequence[Mask]
    spans: Sequence[tuple[int, int]]
    """Frames in which each mask counts: first, and the one after the last."""

    def __len__(self) -> int:
        return len(self.masks)

    def at(self, frame: int) -> Mask | None:
        """What is hidden in a frame; None for nothing."""
        here = [m for m, (first, after) in zip(self.masks, self.spans, strict=True) if first <= frame < after]
        return np.logical_or.reduce(here) if here else None


def regions_of(rule: CameraRule, episode: str, *, height: int, width: int, frames: int, where: str) -> Regions:
    """The regions of a camera's rule that count in an episode.

    Raises:
        ConfigError: a region leaves the picture, is of another size, hides nothing, or begins after the last frame.
    """
    chosen = [(k, r) for k, r in enumerate(rule.regions) if not r.episodes or episode in r.episodes]
    masks = [mask_of(r, height, width, f"{where}.regions.{k}") for k, r in chosen]
    for k, region in chosen:
        if region.frames is not None and region.episodes and region.frames[0] >= frames:
            raise ConfigError(f"frames {list(region.frames)} of an episode that has {frames}",
                              where=f"{where}.regions.{k}", mend=f"count from 0 to {frames}, after the edits before")
    return Regions(masks, [r.frames or (0, frames) for _, r in chosen])


def mask_of(region: Region, height: int, width: int, where: str) -> Mask:
    """A region as a mask.

    Raises:
        ConfigError: it leaves the picture, is of another size, or hides nothing.
    """
    from PIL import Image, ImageDraw

    size = f"the camera has {width}x{height}"
    if region.mask is not None:
        mask = _png(region.mask, where)
        if mask.shape != (height, width):
            raise ConfigError(f"a mask of {mask.shape[1]}x{mask.shape[0]}, {size}", where=where,
                              mend=f"draw it {width}x{height} px, what is to be hidden in white")
    else:
        left, top, wide, high = region.rectangle or (0, 0, 1, 1)
        points = region.polygon or ((left, top), (left + wide - 1, top), (left + wide - 1, top + high - 1),
                                    (left, top + high - 1))
        if any(not (0 <= x < width and 0 <= y < height) for x, y in points):
            raise ConfigError(f"{'polygon' if region.polygon else 'rectangle'} leaves the picture: {size}", where=where,
                              mend=f"keep x within 0..{width - 1} and y within 0..{height - 1}")
        drawn = Image.new("1", (width, height))
        ImageDraw.Draw(drawn).polygon([(float(x), float(y)) for x, y in points], fill=1, outline=1)
        mask = np.asarray(drawn, np.bool_)
    if not mask.any():
        raise ConfigError("the region hides nothing", where=where, mend="draw what is to be hidden in white")
    return mask


def _png(text: str, where: str) -> Mask:
    from PIL import Image

    try:
        with Image.open(io.BytesIO(base64.b64decode(text)), formats=("PNG",)) as picture:
            return np.asarray(picture.convert("L")) > 0
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise ConfigError("the mask cannot be read as a PNG", where=where, mend="save it again as PNG") from error


def filled(picture: Picture, mask: Mask | None, boxes: Sequence[Box], colour: Colour) -> Picture:
    """A copy of a picture with these parts in one colour, every pixel that a box touches included."""
    result = picture.copy()
    if mask is not None:
        result[mask] = colour
    for left, top, right, bottom in boxes:
        rows = slice(max(0, int(np.floor(top))), max(0, int(np.ceil(bottom))))
        result[rows, max(0, int(np.floor(left))):max(0, int(np.ceil(right)))] = colour
    return result
