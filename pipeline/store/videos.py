"""Videos that versions share, and their decoded frames: which of them nobody needs, and which show a recording."""

import json
from collections.abc import Collection, Iterator
from pathlib import Path

from pipeline.lerobot_view.clips import FOLDER as VIDEOS
from pipeline.lerobot_view.frame_cache import FOLDER as FRAMES


def spare(root: Path) -> Iterator[Path]:
    """Videos that no version has a link of, the notes that lead to them or to nothing, and all decoded frames.

    Where files cannot be linked, versions have copies and every video here is spare: it can be encoded again.
    """
    gone: set[str] = set()
    for video in _files(root / VIDEOS, "*.mp4"):
        if not linked(video):
            gone.add(video.stem)
            yield video
    for note in _files(root / VIDEOS, "*.json"):
        if (sha := str(_told(note).get("sha256"))) in gone or not (root / VIDEOS / f"{sha}.mp4").exists():
            yield note
    yield from _files(root / FRAMES, "*.npy")


def linked(video: Path) -> bool:
    """Whether some version holds this very file, too."""
    return video.stat().st_nlink > 1


def showing(root: Path, blobs: Collection[str]) -> list[Path]:
    """Every video, note and file of decoded frames that was made of pictures in files with these hashes.

    A version's own link of such a video is the same file (Path.samefile) under its `videos` folder.
    """
    found: list[Path] = []
    for note in _files(root / VIDEOS, "*.json"):
        told = _told(note)
        if str(told.get("source")).split(" ", 1)[0] in blobs:
            sha = told.get("sha256")
            found += [note, *(p for p in (root / VIDEOS / f"{sha}.mp4", root / FRAMES / f"{sha}.npy") if p.exists())]
    return list(dict.fromkeys(found))


def _files(folder: Path, pattern: str) -> list[Path]:
    """Files of a folder in order; none of one that is a link."""
    return [] if folder.is_symlink() else sorted(p for p in folder.glob(pattern) if not p.is_symlink())


def _told(note: Path) -> dict[str, object]:
    try:
        told = json.loads(note.read_bytes())
    except (OSError, ValueError):
        return {}
    return told if isinstance(told, dict) else {}  # pyright: ignore[reportUnknownVariableType]
