"""What a killed writer left: kept as far as whole, or set aside with the reason."""

import fcntl
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import RecordingError
from pipeline.files import atomic, sync_folder
from pipeline.recording.live_recover import frames_of, is_live, is_whole, rewrite
from pipeline.recording.quarantine import QUARANTINE, set_aside
from pipeline.recording.read import open_recording
from pipeline.recording.scan import Scan, load, reading, scan
from pipeline.recording.verify import verify
from pipeline.recording.write import Recording, encode, named


@dataclass(frozen=True, slots=True)
class Recovered:
    """What became of one leftover .part."""

    part: Path
    kept: Path | None
    """The recording made of it; None where it was quarantined."""
    frames: int
    """Whole ticks that were kept."""
    reason: str
    """Why it is shorter than it was, or why it was quarantined; empty where nothing is missing."""


def recover(folder: Path, *, gate: Callable[[Path], object] | None = None) -> list[Recovered]:
    """Deal with every leftover NAME.mcap.part below `folder`; call it at start-up.

    A file that only missed its rename gets its name. One that ends early is written again as a valid file
    with its whole ticks, outcome 'unknown' and `truncated` in its metadata. Anything else goes to the folder
    quarantine/ beside it, with NAME.mcap.part.reason.txt. A .part that a living process writes is left alone.

    Args:
        folder: where to look, folders below it too.
        gate: looks at each file first and raises RecordingError for one that must not be opened here, such as
            pipeline.logs.inspection.inspect where others may have put files.

    Raises:
        RecordingError: the disk is full or refuses.
    """
    return [done for part in sorted(folder.rglob("*.mcap.part")) if QUARANTINE not in part.parts
            and part.is_file() and (done := _recover_one(part, gate))]


def _recover_one(part: Path, gate: Callable[[Path], object] | None) -> Recovered | None:
    final = part.with_name(part.name.removesuffix(".part"))
    with part.open("rb") as stream, reading(part, "leftover recording"):
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return None
        if final.exists():
            return _quarantine(part, f"{final.name} is already there, whole")
        try:
            if gate:
                gate(part)
            found = scan(load(part), part)
            if is_live(found):
                return _recover_live(found, part, final)
            opened = open_recording(part, accept_truncated=True)
            if opened.lost is None:
                os.fsync(stream.fileno())
                part.replace(final)
                sync_folder(final.parent)
                return Recovered(part, final, opened.episode.frames, "")
            trace = opened.decoder.trace()
        except RecordingError as error:
            return _quarantine(part, error.what)
        item = Recording(final, opened.episode, trace, opened.attachments, _software(opened.strings),
                         truncated=opened.episode.frames < opened.planned)
        with named(final), atomic(final) as whole:
            whole.writelines(encode(item).pieces)
        part.unlink()  # only now: a kill before this line leaves both, and the next start sets the rest aside
    return Recovered(part, final, opened.episode.frames, opened.lost)


def _recover_live(found: Scan, part: Path, final: Path) -> Recovered:
    """Deal with what a live recorder left; every topic is kept, those of cameras too."""
    if is_whole(found):
        verify(part)
        part.replace(final)
        sync_folder(final.parent)
        return Recovered(part, final, frames_of(found), "")
    with named(final), atomic(final) as whole:
        episode, lost = rewrite(found, whole)
    part.unlink()
    return Recovered(part, final, episode.frames, lost or "")


def _software(strings: Mapping[str, str]) -> dict[str, str]:
    kept = ("operator", "site", "purpose", "expires", "software_commit", "simulator_version")
    return {key: strings[key] for key in kept if key in strings}


def _quarantine(part: Path, reason: str) -> Recovered:
    set_aside(part, reason)
    return Recovered(part, None, 0, reason)
