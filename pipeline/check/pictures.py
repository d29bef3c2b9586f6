"""Pictures of logs and videos, small and grey, as the camera checks look at them."""

import io
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.check.signals import THUMB

type Grey = NDArray[np.uint8]

MAX_PIXELS = 64 << 20
"""Above any camera; a picture that declares more is not unpacked."""
RAW_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
"""Encodings of sensor_msgs/Image with 8 bits a channel; Source: sensor_msgs/image_encodings.hpp."""


def small(grey: NDArray[np.generic]) -> Grey:
    """The means of 16 x 12 equal parts of a grey picture, shape (h, w) -> (12, 16)."""
    width, height = THUMB
    rows = np.linspace(0, grey.shape[0], height + 1).astype(int)
    columns = np.linspace(0, grey.shape[1], width + 1).astype(int)
    sums = np.pad(np.cumsum(np.cumsum(grey, axis=0, dtype=np.float64), axis=1), ((1, 0), (1, 0)))
    parts = sums[np.ix_(rows, columns)]
    area = np.outer(np.diff(rows), np.diff(columns))
    total = parts[1:, 1:] - parts[:-1, 1:] - parts[1:, :-1] + parts[:-1, :-1]
    return np.round(total / np.maximum(area, 1)).astype(np.uint8)


def compressed(data: memoryview) -> tuple[Grey, tuple[int, int]] | None:
    """A JPEG, or what else Pillow reads, small and grey, and its full size; None where it does not decode."""
    raw = bytes(data)
    return _jpeg(raw) if raw[:2] == b"\xff\xd8" else _other(raw)


def _jpeg(raw: bytes) -> tuple[Grey, tuple[int, int]] | None:
    simplejpeg: Any = import_module("simplejpeg")  # compiled, and without types
    try:
        height, width, _, _ = simplejpeg.decode_jpeg_header(raw)
        if height * width > MAX_PIXELS:
            return None
        # libjpeg scales while it decodes: an eighth of the work for pictures that are only looked at from afar
        grey = simplejpeg.decode_jpeg(raw, colorspace="GRAY", fastdct=True, min_height=4 * THUMB[1],
                                      min_width=4 * THUMB[0])
    except ValueError:
        return None
    return small(grey[:, :, 0]), (int(width), int(height))


def _other(raw: bytes) -> tuple[Grey, tuple[int, int]] | None:
    from PIL import Image

    try:
        with Image.open(io.BytesIO(raw), formats=("PNG", "WEBP", "BMP", "TIFF")) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                return None
            return small(np.asarray(picture.convert("L"))), picture.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def raw_picture(data: memoryview, encoding: str, width: int, height: int,
                step: int) -> tuple[Grey, tuple[int, int]] | None:
    """A sensor_msgs/Image with 8 bits a channel; None for other encodings and sizes that do not fit."""
    channels = RAW_CHANNELS.get(encoding)
    if channels is None or not 0 < width * channels <= step or height <= 0 or height * step > len(data):
        return None
    rows = np.frombuffer(data, np.uint8, height * step).reshape(height, step)[:, :width * channels]
    return small(rows.reshape(height, width, channels).mean(axis=2)), (width, height)
