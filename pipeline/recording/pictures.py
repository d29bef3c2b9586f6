"""Pictures on their way into a recording: JPEG in sensor_msgs/CompressedImage, which every viewer takes."""

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import RecordingError
from pipeline.recording import cdr

QUALITY = 85
"""JPEG quality: 9 KB for 320 x 240, 0.13 ms of one core; 95 would double both the size and the disk."""


def jpeg(picture: NDArray[np.uint8], *, quality: int = QUALITY) -> bytes:
    """A picture, RGB of shape (height, width, 3), as JPEG with colours at half the resolution."""
    import simplejpeg  # pyright: ignore[reportMissingTypeStubs]

    encode = cast(Callable[..., bytes], simplejpeg.encode_jpeg)  # pyright: ignore[reportUnknownMemberType]
    return encode(np.ascontiguousarray(picture), quality=quality, colorspace="RGB", colorsubsampling="420")


def image_message(camera: str, picture: NDArray[np.uint8] | bytes, stamp_ns: int) -> bytes:
    """CompressedImage of a picture; its frame is the camera's name."""
    return cdr.compressed_image(stamp_ns, camera, "jpeg", picture if isinstance(picture, bytes) else jpeg(picture))


def check_picture(picture: NDArray[np.uint8], where: object) -> None:
    """Raise RecordingError where an array is no RGB picture."""
    if picture.ndim != 3 or picture.shape[2] != 3 or not picture.size or picture.dtype != np.uint8:
        raise _odd(f"{picture.dtype} of shape {picture.shape}", where)


def check_jpeg(picture: bytes, where: object) -> None:
    """Raise RecordingError where bytes are no JPEG."""
    if picture[:2] != b"\xff\xd8":
        raise _odd("bytes that are no JPEG", where)


def _odd(what: str, where: object) -> RecordingError:
    return RecordingError(f"a picture is {what}", where=where, mend="give RGB as uint8 (height, width, 3), or a JPEG")
