"""Videos decoded once: the frames of each in one file that is mapped into memory, under the hash of the video."""

import os
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.files import atomic
from pipeline.lerobot_view.video import AGAIN, decoded

FOLDER = "caches/frames"
"""Where decoded frames lie, relative to the store's root: SHA256.npy. All of it can be made again at any time."""


class FrameCache:
    """Frames by the hash of their video. A frame of 128x128 takes 48 KiB of disk, one of 640x480 900 KiB.

    A file is whole or absent, however its writer ended. Whoever has one mapped keeps it, even where gc deletes it.

    Args:
        folder: made when it is needed.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def frames(self, video: Path, sha: str) -> NDArray[np.uint8]:
        """Every frame of a video, RGB, shape (frames, height, width, 3), read-only; decoded now if it never was.

        Raises:
            DatasetError: the video is damaged, or the disk is full.
        """
        file = self._folder / f"{sha}.npy"
        found = self._mapped(file)
        if found is None:
            try:
                self._decode(video, file)
            except OSError as error:
                raise DatasetError(f"decoded frames cannot be kept: {error.strerror}", where=file,
                                   mend="free space (hardcase gc), or name another folder for the cache") from error
            found = self._mapped(file)
            assert found is not None, "it was written just now"
        return found

    def _mapped(self, file: Path) -> NDArray[np.uint8] | None:
        try:
            frames = np.load(file, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError, EOFError):
            return None
        with suppress(OSError):
            os.utime(file)  # young again: gc leaves it alone
        return np.asarray(frames)

    def _decode(self, video: Path, file: Path) -> None:
        """Frames go through ordinary writes: one into a mapped file would end the process where the disk is full."""
        count, shape = 0, (0, 0, 3)
        with atomic(file) as stream:
            _header(stream, 0, shape)
            for frame in decoded(video):
                count, shape = count + 1, frame.shape
                stream.write(frame.data)
            if not count:
                raise DatasetError("the video has no picture", where=video, mend=AGAIN)
            stream.seek(0)
            _header(stream, count, shape)


def _header(stream: IO[bytes], frames: int, shape: tuple[int, ...]) -> None:
    """What numpy puts before an array; it leaves room for larger numbers, so that all take the same space."""
    numpy: Any = np.lib.format
    numpy.write_array_header_1_0(stream, {"descr": "|u1", "fortran_order": False, "shape": (frames, *shape)})
