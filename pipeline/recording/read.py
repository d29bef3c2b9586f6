"""Read recordings: what was written, or one error that says why not."""

import logging
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.files import sha256
from pipeline.frames import Frames
from pipeline.recording.decode import Decoder, whole_ticks
from pipeline.recording.dialect import FRAME_TOPICS, LEGGED_TOPICS, RESTORE_TOPICS, every_tick
from pipeline.recording.errors import DAMAGED, ends_early, reading, refuse
from pipeline.recording.legged import LeggedDecoder
from pipeline.recording.live_header import cut_off
from pipeline.recording.scan import load, scan
from pipeline.recording.series import Messages, Series, collect
from pipeline.recording.strings import attached_files, episode_strings, finished
from pipeline.recording.summary import read_summary
from pipeline.trace import Event, Trace
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
    """Frames that the episode had before it was cut; one more than were kept where nobody knows."""


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
    return open_recording(path, wanted=FRAME_TOPICS.__contains__, required=FRAME_TOPICS, frames=False).attachments


def _of_a_trace(topic: str) -> bool:
    return every_tick(topic) or topic in {"/task/phase", "/events"}


def open_recording(path: Path, *, accept_truncated: bool = False, wanted: Callable[[str], bool] = _of_a_trace,
                   required: tuple[str, ...] = FRAME_TOPICS + RESTORE_TOPICS, frames: bool = True) -> Opened:
    """Scan, unpack and check a recording; the data are trusted over the summary.

    Args:
        path, accept_truncated: see read_episode.
        wanted: which topics are unpacked.
        required: topics of the reference arm without which it is of no use; a legged robot has its own.
        frames: whether a recording must hold the frames of a dataset where those of the arm are all that is wanted.

    Raises:
        RecordingError: see read_episode.
    """
    data = load(path)
    found = scan(data, path)
    ended = finished(found)
    messages = collect(found, lambda topic: wanted(topic) or (topic == "/events" and not ended),
                       tolerant=accept_truncated)
    lost = found.end or (messages.broken and messages.broken.what) or (None if ended else "it was never closed")
    if not lost and not found.sound:
        raise refuse("data section: CRC mismatch; quarantined", path, DAMAGED)
    if lost and not accept_truncated:
        raise ends_early(messages.total, (messages.last_ns - messages.first_ns) / 1e9, path)
    if not lost:
        _count_against_summary(data, messages, path)
    strings = episode_strings(found, path)
    with reading(path, "metadata record 'episode'"):
        episode = Episode.model_validate_json(strings["episode_json"])
    topics, kind = messages.topics, Decoder
    if episode.scene.legged is not None:
        kind, required = LeggedDecoder, _of_legs(required, topics, path, frames=frames)
    if not any(topic in topics for topic in RESTORE_TOPICS):  # a real robot: nothing can be restored
        required = tuple(topic for topic in required if topic not in RESTORE_TOPICS)
    ticks, gap = whole_ticks(topics, required, episode, where=path, exact=not accept_truncated)
    lost, planned = lost or gap, episode.frames if ended else None
    if ticks != planned:
        events = kind(topics, episode, ticks, path).events() if planned is None else ()
        episode = _cut(episode, ticks, planned, str(lost), path, events)
    episode = episode.model_copy(update={"blob": sha256(data)})
    return Opened(episode, kind(topics, episode, ticks, path), attached_files(found), strings, lost,
                  planned or ticks + 1)


def _of_legs(required: tuple[str, ...], topics: Mapping[str, Series], path: Path, *, frames: bool) -> tuple[str, ...]:
    """What a legged robot's recording must hold, of what was unpacked; RecordingError where frames are asked of it."""
    if required != FRAME_TOPICS:
        return LEGGED_TOPICS + RESTORE_TOPICS
    if frames:
        raise refuse("a legged robot's recording has no frames of a dataset: its falls teach by their starts", path,
                     "hardcase loop --recipe biped; or read it whole: pipeline.recording.read_episode")
    return tuple(topic for topic in LEGGED_TOPICS if topic in topics)


def _count_against_summary(data: bytes, messages: Messages, path: Path) -> None:
    try:
        listed = read_summary(data).messages
    except (ValueError, struct.error) as error:
        _LOG.warning("%s: summary is damaged (%s); summary ignored", path, error)
        return
    if listed != messages.total:
        _LOG.warning("%s: summary lists %d messages, data has %d; summary ignored", path, listed, messages.total)


def _cut(episode: Episode, ticks: int, planned: int | None, lost: str, path: Path,
         events: tuple[Event, ...]) -> Episode:
    """The episode as far as it was recorded; how it ended is not known."""
    if ticks == 0 or (planned is not None and ticks > planned):
        raise refuse(f"{ticks} whole ticks of {planned or 'an unknown number'}", path,
                     "drop it: there is nothing to keep")
    if planned is None:
        with reading(path, "events named 'segment'"):
            return cut_off(episode, ticks, [(e.tick, e.text) for e in events if e.name == "segment"], lost)
    segments = tuple(s.model_copy(update={"stop": min(s.stop, ticks)}) for s in episode.segments if s.start < ticks)
    reason = f"truncated: {ticks} of {planned} frames kept; {lost}"
    outcome = Outcome(label="unknown", judged_by=episode.outcome.judged_by, reason=reason, trigger=None, family=None,
                      tick=None)
    return episode.model_copy(update={"frames": ticks, "segments": segments, "outcome": outcome})
