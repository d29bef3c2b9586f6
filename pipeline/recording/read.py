"""Read recordings: what was written, or one error that says why not."""

import logging
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.files import sha256
from pipeline.frames import Frames
from pipeline.recording import metadata
from pipeline.recording.decode import Decoder, whole_ticks
from pipeline.recording.dialect import FRAME_TOPICS, RESTORE_TOPICS, every_tick
from pipeline.recording.scan import DAMAGED, Scan, load, reading, refuse, scan
from pipeline.recording.series import Messages, collect
from pipeline.recording.summary import read_summary
from pipeline.trace import Trace
from schemas.episode import Episode, Outcome

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Opened:
    """A recording that was read, checked and cut to its whole ticks."""

    episode: Episode
    decoder: Decoder
    attachments: dict[str, bytes]
    strings: dict[str, str]
    """The metadata record."""
    lost: str | None
    """Why it ends early; None where it is whole."""
    planned: int
    """Frames that the episode had before it was cut."""


def read_episode(path: Path, *, accept_truncated: bool = False) -> tuple[Episode, Trace]:
    """Read all of a recording; arrays come back bit for bit, `blob` is the file's sha256.

    Args:
        path: a .mcap file of the dialect.
        accept_truncated: keep the whole ticks of a file that ends early, with outcome 'unknown'.

    Raises:
        RecordingError: damaged, hostile, incomplete or not of the dialect.
    """
    opened = open_recording(path, accept_truncated=accept_truncated)
    return opened.episode, opened.decoder.trace()


def read_frames(path: Path, *, accept_truncated: bool = False) -> tuple[Episode, Frames]:
    """Read the dataset features of a recording; they equal Trace.frames(). See read_episode.

    Simulator state and true poses are not even looked at.
    """
    opened = open_recording(path, accept_truncated=accept_truncated, wanted=FRAME_TOPICS.__contains__,
                            required=FRAME_TOPICS)
    found = opened.decoder.features()
    columns = (found[name].astype(np.float32) for name in ("state", "environment", "action", "joint_action"))
    return opened.episode, Frames(*columns)


def read_attachments(path: Path) -> dict[str, bytes]:
    """File name -> content of everything attached: the scene, the config, the URDF, the draws."""
    return open_recording(path, wanted=FRAME_TOPICS.__contains__, required=FRAME_TOPICS).attachments


def _of_a_trace(topic: str) -> bool:
    return every_tick(topic) or topic in {"/task/phase", "/events"}


def open_recording(path: Path, *, accept_truncated: bool = False, wanted: Callable[[str], bool] = _of_a_trace,
                   required: tuple[str, ...] = FRAME_TOPICS + RESTORE_TOPICS) -> Opened:
    """Scan, unpack and check a recording; the data are trusted over the summary.

    Raises:
        RecordingError: see read_episode.
    """
    data = load(path)
    found = scan(data, path)
    messages = collect(found, wanted, tolerant=accept_truncated)
    lost = found.end or (messages.broken and messages.broken.what)
    if not lost and not found.sound:
        raise refuse("data section: CRC mismatch; quarantined", path, DAMAGED)
    if lost and not accept_truncated:
        seconds = (messages.last_ns - messages.first_ns) / 1e9
        raise refuse(f"episode ends early after message {messages.total} (t = {seconds:.2f} s); recovered "
                     f"{messages.total}; pass --accept-truncated to keep it", path,
                     "pass --accept-truncated to keep what is whole, or record the episode again")
    if not lost:
        _count_against_summary(data, messages, path)
    strings = _strings(found, path)
    with reading(path, "metadata record 'episode'"):
        episode = Episode.model_validate_json(strings["episode_json"])
    topics = messages.topics
    ticks = whole_ticks(topics, required, episode, where=path, exact=lost is None)
    planned = episode.frames
    if ticks != planned:
        episode = _cut(episode, ticks, str(lost), path)
    episode = episode.model_copy(update={"blob": sha256(data)})
    return Opened(episode, Decoder(topics, episode, ticks, path), _attachments(found), strings, lost, planned)


def _count_against_summary(data: bytes, messages: Messages, path: Path) -> None:
    try:
        listed = read_summary(data).messages
    except (ValueError, struct.error) as error:
        _LOG.warning("%s: summary is damaged (%s); summary ignored", path, error)
        return
    if listed != messages.total:
        _LOG.warning("%s: summary lists %d messages, data has %d; summary ignored", path, listed, messages.total)


def _strings(found: Scan, path: Path) -> dict[str, str]:
    """The strings of the metadata record `episode`."""
    for start, stop in found.metadata:
        with reading(path, f"metadata at byte {start - 9}"):
            name, at = _text(found.data, start, stop)
            if name == metadata.NAME:
                (size,) = struct.unpack_from("<I", found.data, at)
                values: dict[str, str] = {}
                at, end = at + 4, at + 4 + size
                while at < min(end, stop):
                    key, at = _text(found.data, at, stop)
                    values[key], at = _text(found.data, at, stop)
                if metadata.SEAL in values and values[metadata.SEAL] != metadata.seal(values):
                    raise ValueError("sha256 mismatch")
                return values
    raise refuse("no metadata record 'episode'", path,
                 "record with pipeline.recording, or bring the file in as a foreign log")


def _attachments(found: Scan) -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    for start, stop in found.attachments:
        with reading(found.where, f"attachment at byte {start - 9}"):
            name, at = _text(found.data, start + 16, stop)
            _, at = _text(found.data, at, stop)
            (size,) = struct.unpack_from("<Q", found.data, at)
            if at + 8 + size + 4 != stop:
                raise ValueError(f"{size} B do not fit its record")
            (crc,) = struct.unpack_from("<I", found.data, stop - 4)
            if zlib.crc32(memoryview(found.data)[start : stop - 4]) != crc:
                raise ValueError("CRC mismatch")
            files[name] = found.data[at + 8 : stop - 4]
    return files


def _text(data: bytes, at: int, stop: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", data, at)
    if at + 4 + size > stop:
        raise ValueError(f"string of {size} B at byte {at} runs over its record")
    return data[at + 4 : at + 4 + size].decode(), at + 4 + size


def _cut(episode: Episode, ticks: int, lost: str, path: Path) -> Episode:
    """The episode as far as it was recorded; how it ended is not known."""
    if not 0 < ticks < episode.frames:
        raise refuse(f"{ticks} whole ticks of {episode.frames}", path, "drop it: there is nothing to keep")
    segments = tuple(s.model_copy(update={"stop": min(s.stop, ticks)}) for s in episode.segments if s.start < ticks)
    reason = f"truncated: {ticks} of {episode.frames} frames kept; {lost}"
    outcome = Outcome(label="unknown", judged_by=episode.outcome.judged_by, reason=reason, trigger=None, family=None,
                      tick=None)
    return episode.model_copy(update={"frames": ticks, "segments": segments, "outcome": outcome})

