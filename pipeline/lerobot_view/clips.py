"""Clips: the video of one episode and camera, encoded once and shared by every version that holds the episode."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.files import atomic, sha256, sha256_file, source_hash, sync_folder
from pipeline.footage import Footage, Picture, fitted
from pipeline.lerobot_view import pixels, video
from pipeline.lerobot_view.pixels import Histogram
from schemas.recipe import CameraConfig

FOLDER = "videos"
"""Where encoded videos lie, relative to the store's root: SHA256.mp4, and KEY.json that says what was encoded so."""


@dataclass(frozen=True, slots=True)
class Clip:
    """Where the pictures of one episode and camera are, and what is known of them."""

    file: Path
    """An mp4 that never changes."""
    sha256: str
    """Of the file."""
    key: str
    """Hash of what was encoded, and how."""
    source: str
    """What the pictures follow from, the hash of their file first; see Footage."""
    height: int
    width: int
    frames: int
    """Of the episode."""
    histogram: Histogram
    """Of the episode's pixels as they were encoded."""
    first: int = 0
    """Frames of the file before those of the episode."""
    repeated: int = 0
    """Frames that show the picture before them once more."""


class Clips:
    """The videos of a store, each under the hash of its bytes, found by what it was encoded from.

    Nothing here is the only copy: a video can be made again from its recording, and a version keeps a link of its own.

    Args:
        store: root of the store.
        known: clips that lie elsewhere, by key: those of a parent version.
    """

    def __init__(self, store: Path, known: Mapping[str, Clip] | None = None) -> None:
        self.folder, self._known = store / FOLDER, known or {}

    def clip(self, footage: Footage, wanted: CameraConfig, *, fps: int, part: Path, where: object) -> Clip:
        """The video of some footage; it is encoded only if it never was.

        Args:
            footage: what the camera saw.
            wanted: crop and size.
            fps: frames a second.
            part: where to encode to, on the store's file system; nothing is left there.
            where: what to name in errors.

        Raises:
            HardcaseError: a picture cannot be used; names it.
            OSError: the disk is full or read-only.
        """
        key = key_of(footage, wanted, fps)
        found = self.find(key) or self._known.get(key)
        if found is None:
            found = self._encoded(footage, wanted, key, fps, part, where)
        return replace(found, repeated=footage.repeated)

    def _encoded(self, footage: Footage, wanted: CameraConfig, key: str, fps: int, part: Path, where: object) -> Clip:
        counts = pixels.empty()
        pictures = pixels.counted(_fitted(footage.pictures(), wanted, where), counts)
        part.parent.mkdir(parents=True, exist_ok=True)
        try:
            frames, height, width = video.encode(pictures, part, fps=fps, where=where)
            return self.add(part, Clip(part, "", key, footage.source, height, width, frames, counts))
        finally:
            part.unlink(missing_ok=True)

    def add(self, part: Path, clip: Clip) -> Clip:
        """Take a finished video in, the file itself, and remember what `clip` says of it.

        Its bytes are on the disk before its name, its name before the note that leads to it.
        """
        sha = sha256_file(part)
        file = self.folder / f"{sha}.mp4"
        self.folder.mkdir(parents=True, exist_ok=True)
        part.chmod(0o444)
        with part.open("rb") as stream:
            os.fsync(stream.fileno())
        part.rename(file)
        sync_folder(self.folder)
        made = replace(clip, file=file, sha256=sha)
        with atomic(self.folder / f"{clip.key}.json") as stream:
            stream.write(json.dumps(_note(made)).encode())
        return made

    def find(self, key: str) -> Clip | None:
        """What was encoded under this key, if it is still there whole by its size."""
        note = self.folder / f"{key}.json"
        try:
            told: dict[str, Any] = json.loads(note.read_bytes())
            clip = Clip(self.folder / f"{told['sha256']}.mp4", told["sha256"], key, told["source"], told["height"],
                        told["width"], told["frames"], np.array(told["histogram"], np.int64))
            if clip.file.stat().st_size != told["bytes"]:
                return None
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return None
        with suppress(PermissionError):  # another user's, who keeps their own time
            os.utime(clip.file)  # young again: gc leaves it alone until a version has a link of its own
            os.utime(note)
        return clip


def _fitted(pictures: Iterable[Picture], wanted: CameraConfig, where: object) -> Iterator[Picture]:
    """Every picture as it is kept; one that comes again at once is the same array again."""
    last, held = None, np.empty((0, 0, 3), np.uint8)
    for picture in pictures:
        if picture is not last:
            last, held = picture, fitted(picture, wanted, where)
        yield held


def _note(clip: Clip) -> dict[str, object]:
    return {"sha256": clip.sha256, "bytes": clip.file.stat().st_size, "source": clip.source, "height": clip.height,
            "width": clip.width, "frames": clip.frames, "histogram": clip.histogram.tolist()}


def key_of(footage: Footage, wanted: CameraConfig, fps: int) -> str:
    """Hash of everything that decides the bytes of a video: pictures, crop, size, rate, encoder settings and code."""
    how = wanted.model_dump(mode="json", exclude={"max_skew_s"})
    return sha256(json.dumps([footage.source, how, fps, video.CODEC, video.PIX_FMT, video.OPTIONS, code_hash()],
                             sort_keys=True).encode())


def code_hash() -> str:
    """Hash of every source file that decides which bytes footage becomes."""
    from pipeline import footage

    return source_hash(Path(m.__file__ or "") for m in (footage, video, pixels))
