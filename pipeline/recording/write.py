"""Write recordings: whole under their name, or not there at all."""

import errno
import fcntl
import hashlib
import os
import shutil
from collections.abc import Generator, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import batched
from pathlib import Path
from typing import BinaryIO

from pipeline.errors import RecordingError
from pipeline.files import sync_folder
from pipeline.recording.assemble import Assembly, assemble
from pipeline.recording.columns import check_trace, columns, singles
from pipeline.recording.metadata import NAME, episode_metadata
from pipeline.recording.summary import read_summary
from pipeline.trace import Trace
from schemas.consent import Consent
from schemas.episode import Episode

RESERVE_BYTES = 64 << 20
"""Free space that a recording must leave, so that catalog and logs can still be written [B]."""
_GROUP = 256
"""Files kept open at once; well below the usual limit of 1024."""
_SYNCS = 16
"""Syncs in flight: a journal commits those that wait together."""
_MORE_ROOM = "free space (hardcase gc) or name another disk: HARDCASE_STORE=FOLDER"
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_FORBIDDEN = {errno.EACCES, errno.EPERM, errno.EROFS}


@dataclass(frozen=True, slots=True)
class Recording:
    """One file to write; see write_episode."""

    path: Path
    episode: Episode
    trace: Trace
    attachments: Mapping[str, bytes]
    software: Mapping[str, str] = field(default_factory=dict[str, str])
    truncated: bool = False
    consent: Consent | None = None


def write_episode(path: Path, episode: Episode, trace: Trace, *, attachments: Mapping[str, bytes],
                  software: Mapping[str, str] | None = None, fsync: bool = True,
                  reserve_bytes: int = RESERVE_BYTES, consent: Consent | None = None) -> str:
    """Write one episode as NAME.mcap and return the file's sha256.

    The bytes follow from the arguments alone. The file is written as NAME.mcap.part, flushed, synced, its
    summary read again, then renamed: a reader never sees half of it under its name.

    Args:
        path: the final name, ending in .mcap.
        episode: what was attempted; `blob` is left out of the file, since it is the file's own hash.
        trace: what happened, one row a tick.
        attachments: scene.xml, config.json, robot.urdf, randomization.json; the URDF also goes to /robot_description.
        software: software_commit, simulator_version and further strings for the metadata.
        fsync: False leaves the bytes to the page cache: they may be gone after a power cut.
        reserve_bytes: free space to leave on the disk [B].
        consent: the record that the episode refers to, where a person was recorded.

    Raises:
        RecordingError: the trace or the consent does not fit the episode, or the disk is short, full or refuses.
    """
    item = Recording(path, episode, trace, attachments, software or {}, consent=consent)
    return write_episodes([item], fsync=fsync, reserve_bytes=reserve_bytes)[0]


def write_episodes(items: Iterable[Recording], *, fsync: bool = True, reserve_bytes: int = RESERVE_BYTES) -> list[str]:
    """Write many episodes and return their sha256 in order; see write_episode.

    Of each group of 256, all files are durable before the first is renamed. Syncs overlap with the
    encoding of the next file and with each other.
    """
    return [digest for group in batched(items, _GROUP) for digest in _write_group(group, fsync, reserve_bytes)]


def encode(item: Recording) -> Assembly:
    """A recording in memory; RecordingError where trace and episode do not fit."""
    episode, trace, where = item.episode, item.trace, item.path
    if item.path.suffix != ".mcap":
        raise RecordingError(f"a recording is named .mcap, not {item.path.suffix!r}", where=where,
                             mend=f"write to {item.path.with_suffix('.mcap').name}")
    if (len(trace), trace.hz) != (episode.frames, episode.control_hz):
        raise RecordingError(f"trace has {len(trace)} ticks at {trace.hz} Hz, its episode says {episode.frames} "
                             f"at {episode.control_hz} Hz",
                             where=where, mend="make the Episode from the trace it tells of")
    if item.consent is not None and item.consent.id != episode.consent:
        raise RecordingError(f"the episode refers to consent {episode.consent!r}, not to {item.consent.id!r}",
                             where=where, mend="set Episode.consent to the id of the record")
    check_trace(trace, where)
    metadata = episode_metadata(episode, software=item.software, truncated=item.truncated, consent=item.consent)
    found = singles(trace, item.attachments.get("robot.urdf"))
    return assemble(list(columns(trace)), found, ticks=len(trace), hz=trace.hz, metadata={NAME: metadata},
                    attachments=item.attachments)


def part_of(path: Path) -> Path:
    """The name a recording has until it is whole."""
    return path.with_name(path.name + ".part")


def _write_group(items: Sequence[Recording], fsync: bool, reserve_bytes: int) -> list[str]:
    """Write all, sync all, read every summary again, rename all; on any failure leave no .part behind."""
    started: list[tuple[Recording, int, Future[None] | None]] = []
    digests: list[str] = []
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(_SYNCS))
        try:
            for item in items:
                file = encode(item)
                with named(item.path):
                    leave_reserve(item.path.parent, file.offset, reserve_bytes)
                    stream = stack.enter_context(_locked_part(item.path))
                    started.append((item, sum(file.counts.values()), None))
                    digests.append(_write(stream, file.pieces))
                    if fsync:
                        started[-1] = (*started[-1][:2], pool.submit(os.fsync, stream.fileno()))
            for item, messages, synced in started:
                with named(item.path):
                    if synced:
                        synced.result()
                    _read_back(part_of(item.path), messages)
            for item, _, _ in started:
                with named(item.path):
                    part_of(item.path).replace(item.path)
        except BaseException:
            for item, _, _ in started:
                part_of(item.path).unlink(missing_ok=True)
            raise
    for folder in sorted({item.path.parent for item in items}) if fsync else ():
        with named(folder):
            sync_folder(folder)
    return digests


@contextmanager
def _locked_part(path: Path) -> Generator[BinaryIO]:
    """An empty .part, locked until it has its name: the lock tells recover() that its writer lives."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(part_of(path), os.O_CREAT | os.O_WRONLY | os.O_CLOEXEC, 0o644)
    stream = os.fdopen(handle, "wb")
    try:
        lock(handle, part_of(path))
        if os.fstat(handle).st_size:  # what a killed writer left of the same episode
            os.ftruncate(handle, 0)
        yield stream
    finally:
        with suppress(OSError):  # flushed and synced long ago, or the error is on its way already
            stream.close()


def lock(handle: int, part: Path) -> None:
    """Take the lock of a .part, or raise RecordingError because its writer lives; it ends with the handle."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        mend = "wait for the other loop, or use a store of your own: HARDCASE_STORE=FOLDER"
        raise RecordingError("recording is being written by another process", where=part, mend=mend) from error


def _write(stream: BinaryIO, pieces: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for piece in pieces:
        stream.write(piece)
        digest.update(piece)
    stream.flush()
    return digest.hexdigest()


def _read_back(part: Path, messages: int) -> None:
    """Raise ValueError unless the file's own summary reads and counts what was meant to be written."""
    found = read_summary(part.read_bytes()).messages
    if found != messages:
        raise ValueError(f"{found} messages of {messages}")


def leave_reserve(folder: Path, size: int, reserve_bytes: int) -> None:
    """Raise RecordingError unless `size` bytes fit into a folder's disk and the reserve stays free."""
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free - size < reserve_bytes:
        what = f"{free >> 20} MiB free, a recording of {size >> 10} KiB must leave {reserve_bytes >> 20} MiB"
        raise RecordingError(what, where=folder, mend=_MORE_ROOM)


@contextmanager
def named(path: Path) -> Generator[None]:
    """Turn what the disk reports into one error that names the file and the mend."""
    try:
        yield
    except ValueError as error:
        raise RecordingError(f"recording does not read back: {error}", where=part_of(path),
                             mend="check the disk (dmesg | tail), then run the same command again") from error
    except OSError as error:
        mend = "check the disk (dmesg | tail), then run the same command again"
        if error.errno in _FULL:
            mend = _MORE_ROOM
        elif error.errno in _FORBIDDEN:
            mend = f"make {path.parent} writable or name another folder: HARDCASE_STORE=FOLDER"
        what = f"recording not written: {os.strerror(error.errno or 0)}"
        raise RecordingError(what, where=path, mend=mend) from error
