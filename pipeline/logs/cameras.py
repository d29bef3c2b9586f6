"""Images of a foreign camera: written down as they come, unchanged, in one file that gives each by its number."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import opened, pa, scalars
from pipeline.errors import DatasetError

FORMAT = "hardcase-images-1"
TOGETHER = 4 << 20
"""Bytes of images that go into one record batch, about."""

_MAGIC = {b"\xff\xd8\xff": "jpeg", b"\x89PN": "png"}


class ImageWriter:
    """One Arrow file: columns stamp_ns and image, in the order in which the images came."""

    def __init__(self, file: Path) -> None:
        self.images, self.format = 0, ""
        self._schema = pa.schema([("stamp_ns", pa.int64()), ("image", pa.large_binary())], {"format": FORMAT})
        self._writer: Any = pa.ipc.new_file(str(file), self._schema)
        self._stamps: list[int] = []
        self._images: list[bytes] = []
        self._bytes = 0

    def append(self, stamp_ns: int, image: memoryview) -> None:
        """Take one image."""
        self.format = self.format or _MAGIC.get(bytes(image[:3]), "")
        self._stamps.append(stamp_ns)
        self._images.append(bytes(image))
        self._bytes += len(image)
        self.images += 1
        if self._bytes >= TOGETHER:
            self._flush()

    def close(self) -> None:
        """Finish the file."""
        self._flush()
        self._writer.close()

    def _flush(self) -> None:
        if not self._images:
            return
        offsets = np.zeros(len(self._images) + 1, np.int64)
        np.cumsum([len(image) for image in self._images], out=offsets[1:])
        buffers = [None, pa.py_buffer(offsets), pa.py_buffer(b"".join(self._images))]
        images = pa.Array.from_buffers(pa.large_binary(), len(self._images), buffers)
        stamps = scalars(np.array(self._stamps, np.int64))
        self._writer.write_batch(pa.RecordBatch.from_arrays([stamps, images], schema=self._schema))
        self._stamps, self._images, self._bytes = [], [], 0


class Images:
    """The images of one camera by number, read when they are asked for."""

    def __init__(self, file: Path) -> None:
        """Open a file of `ImageWriter`.

        Raises:
            DatasetError: it is missing, damaged or something else.
        """
        try:
            self._reader, sizes = opened(file, FORMAT)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise DatasetError(f"not a file of camera images ({error})", where=file,
                               mend="convert the log again: hardcase ingest") from error
        self._ends = np.cumsum(sizes)

    def __len__(self) -> int:
        return int(self._ends[-1]) if self._ends.size else 0

    def __getitem__(self, number: int) -> bytes:
        """Bytes of image 0, 1, 2, ..., as the robot published them."""
        if not 0 <= number < len(self):
            raise IndexError(number)
        batch = int(np.searchsorted(self._ends, number, "right"))
        first = int(self._ends[batch - 1]) if batch else 0
        return self._reader.get_batch(batch).column("image")[number - first].as_py()

    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamp of every image on the camera's clock [ns]."""
        parts: Iterator[Any] = (self._reader.get_batch(k).column("stamp_ns") for k in range(len(self._ends)))
        return np.concatenate([np.zeros(0, np.int64), *(np.array(p.to_pylist(), np.int64) for p in parts)])
