"""Files that are set aside: kept as they are, with the reason beside them."""

import os
import shutil
from pathlib import Path

from pipeline.errors import HardcaseError, RecordingError
from pipeline.files import atomic, sync_folder

QUARANTINE = "quarantine"


def set_aside(path: Path, reason: str, *, folder: Path | None = None) -> Path:
    """Move a file into a folder of its kind, NAME.reason.txt beside it.

    Nothing that is there already is replaced: a second file of the name gets a number.

    Args:
        path: the file.
        reason: why, in a line.
        folder: where to; by default `quarantine` beside the file.

    Returns:
        Where it lies now.

    Raises:
        RecordingError: the disk refuses.
    """
    folder = folder or path.parent / QUARANTINE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        target, number = folder / path.name, 1
        while target.exists() or _reason(target).exists():
            target, number = folder / f"{path.name}.{number}", number + 1
        with atomic(_reason(target)) as text:
            text.write(f"{reason}\n".encode())
        _move(path, target)
    except OSError as error:
        raise RecordingError(f"cannot be set aside: {error.strerror}", where=path,
                             mend=f"make {folder} writable, or move the file by hand: {reason}") from error
    return target


def note_refused(path: Path, error: HardcaseError, folder: Path) -> Path:
    """Leave a file of somebody else's where it is and write down why it was refused, as NAME.reason.txt in `folder`.

    Returns:
        The note.

    Raises:
        RecordingError: the disk refuses.
    """
    note, number = folder / f"{path.name}.reason.txt", 1
    try:
        while note.exists() and note.read_text() != f"{error}\n":
            note, number = folder / f"{path.name}.{number}.reason.txt", number + 1
        with atomic(note) as text:
            text.write(f"{error}\n".encode())
    except OSError as failure:
        raise RecordingError(f"the reason for a refusal cannot be written: {failure.strerror}", where=folder,
                             mend=f"make it writable; {path} was refused: {error.what}") from failure
    return note


def _reason(target: Path) -> Path:
    return target.with_name(f"{target.name}.reason.txt")


def _move(path: Path, target: Path) -> None:
    """Rename, or copy to another disk and remove."""
    try:
        path.replace(target)
    except OSError:
        part = target.with_name(f".{target.name}.part")
        shutil.copyfile(path, part)
        with part.open("rb") as stream:
            os.fsync(stream.fileno())
        part.replace(target)
        path.unlink()
    sync_folder(target.parent)
    sync_folder(path.parent)
