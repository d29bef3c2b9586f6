"""Footage: what one camera saw in one episode, a picture for every frame, whatever file the pictures come from."""

import io
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.files import sha256
from schemas.episode import Episode
from schemas.recipe import CameraConfig

type Picture = NDArray[np.uint8]
"""RGB, shape (height, width, 3)."""

MAX_PIXELS = 64 << 20
"""Above any camera; a picture that declares more is not unpacked."""
LEAST = 16
"""Smallest edge that the encoder takes [px]."""

FEATURE = "observation.images."
"""Video features are observation.images.CAMERA."""
SKEW = "skew.camera."
"""Columns skew.camera.CAMERA: frame minus picture [s], positive where the picture is older."""


class Footage(Protocol):
    """One camera of one episode, read when it is asked for."""

    @property
    def source(self) -> str:
        """What its pictures follow from, as text: hashes of the files, and which picture each frame shows."""
        ...

    @property
    def skew_s(self) -> NDArray[np.float32]:
        """How much older than its frame each frame's picture is, shape (frames,) [s]."""
        ...

    @property
    def repeated(self) -> int:
        """Frames without a picture of their own: they show the one before once more."""
        ...

    def pictures(self) -> Iterator[Picture]:
        """A picture a frame; one that is shown again is the same array again.

        Raises:
            HardcaseError: a picture is damaged; names it.
        """
        ...


type FootageOf = Callable[[Episode, str], Footage]
"""Gives the footage of an episode by a camera; raises HardcaseError where there is none."""


def source_of(file: str, uses: NDArray[np.int64]) -> str:
    """The `source` of pictures in a file with this hash, the frames of which show pictures by these numbers."""
    return f"{file} {sha256(uses.astype('<i8').tobytes())}"


def repeats(uses: NDArray[np.int64]) -> int:
    """How many frames show the picture of the frame before once more."""
    return int((np.diff(uses) == 0).sum())


def shown(uses: Sequence[int], picture: Callable[[int], Picture]) -> Iterator[Picture]:
    """The picture of every frame; what is shown again is not made again."""
    last, held = -1, np.empty((0, 0, 3), np.uint8)
    for number in uses:
        if number != last:
            last, held = number, picture(number)
        yield held


def decode(data: bytes, where: object) -> Picture:
    """A JPEG or PNG as RGB.

    Raises:
        DatasetError: it is damaged, of another kind, or larger than any camera's.
    """
    from PIL import Image

    try:
        if data[:2] == b"\xff\xd8":
            return _jpeg(data)
        with Image.open(io.BytesIO(data), formats=("PNG",)) as picture:
            _check_size(picture.width, picture.height)
            return np.asarray(picture.convert("RGB"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise DatasetError(f"a picture cannot be decoded: {reason}", where=where,
                           mend="leave the episode out; see what else is wrong with it: hardcase check") from error


def fitted(picture: Picture, wanted: CameraConfig, where: object) -> Picture:
    """What a version keeps of a picture: cropped, scaled, and of even size.

    Pictures are scaled with bilinear weights over all the pixels that fall into one (Pillow's BILINEAR). Where no
    size is asked for, an odd last row or column is cut off.

    Raises:
        DatasetError: the crop leaves the picture, or too little is left.
    """
    if wanted.crop is not None:
        left, top, width, height = wanted.crop
        if left + width > picture.shape[1] or top + height > picture.shape[0]:
            raise DatasetError(f"crop {wanted.crop} leaves a picture of {picture.shape[1]}x{picture.shape[0]}",
                               where=where, mend="give left, top, width, height inside it: dataset.cameras")
        picture = picture[top:top + height, left:left + width]
    if wanted.width is not None and wanted.height is not None:
        picture = _scaled(picture, wanted.width, wanted.height)
    picture = picture[:picture.shape[0] // 2 * 2, :picture.shape[1] // 2 * 2]
    if min(picture.shape[:2]) < LEAST:
        raise DatasetError(f"a picture of {picture.shape[1]}x{picture.shape[0]}, the encoder takes {LEAST}x{LEAST} "
                           "and more", where=where, mend="give a width and height: dataset.cameras")
    return np.ascontiguousarray(picture)


def _scaled(picture: Picture, width: int, height: int) -> Picture:
    from PIL import Image

    if picture.shape[:2] == (height, width):
        return picture
    return np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.BILINEAR))


def _jpeg(data: bytes) -> Picture:
    import simplejpeg  # pyright: ignore[reportMissingTypeStubs]

    reader: Any = simplejpeg
    height, width, _, _ = reader.decode_jpeg_header(data)
    _check_size(width, height)
    return reader.decode_jpeg(data, colorspace="RGB")


def _check_size(width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise ValueError(f"it declares {width}x{height}, limit {MAX_PIXELS} pixels")
