"""Footage of an ingested log: which image each frame uses was settled by the conversion, the images lie beside it."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.footage import SKEW, Picture, decode, repeats, shown, source_of
from pipeline.logs.cameras import Images
from pipeline.logs.tables import FrameFile


class IngestedFootage:
    """What a camera of an ingested log saw in one episode; see pipeline.footage.Footage.

    Args:
        frames: the file of frames of the conversion.
        number: of the episode in it.
        camera: its name in the map.
        images: its file of images.
        blob: hash of that file.

    Raises:
        DatasetError: one of the files is damaged.
    """

    def __init__(self, frames: FrameFile, number: int, camera: str, images: Path, *, blob: str) -> None:
        self._images, self._camera = images, camera
        self._uses = frames.images(number, camera)
        self._skews = frames.table(number).values[f"{SKEW}{camera}"][:, 0]
        self.source, self.repeated = source_of(blob, self._uses), repeats(self._uses)

    @property
    def skew_s(self) -> NDArray[np.float32]:
        """See Footage."""
        return self._skews

    def pictures(self) -> Iterator[Picture]:
        """See Footage."""
        images = Images(self._images)

        def picture(number: int) -> Picture:
            where = f"camera {self._camera}, image {number}"
            if not 0 <= number < len(images):
                raise DatasetError(f"there are {len(images)} images", where=where, mend="convert the log again")
            return decode(images[number], where)

        return shown(self._uses.tolist(), picture)
