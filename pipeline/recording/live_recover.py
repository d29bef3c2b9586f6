"""What a killed live recording left, made a whole file: every topic kept, cameras too, and marked as cut off."""

import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from pipeline.errors import RecordingError
from pipeline.recording import cdr, fields
from pipeline.recording.dialect import every_tick
from pipeline.recording.errors import reading, refuse
from pipeline.recording.live_file import LiveFile
from pipeline.recording.live_header import START, cut_off
from pipeline.recording.metadata import NAME, SEAL, episode_metadata, seal
from pipeline.recording.records import MESSAGE_HEAD, Op
from pipeline.recording.scan import Scan, unpack
from pipeline.recording.series import Walk
from pipeline.recording.strings import attached_files, episode_strings, finished, strings_of
from pipeline.recording.summary import read_summary
from pipeline.recording.verify import verify
from schemas.episode import Episode


@dataclass(slots=True)
class Kept:
    """What the whole chunks of a leftover hold, besides their bytes."""

    frames: int = 0
    """Ticks, counted by their highest number."""
    first_ns: int = 0
    last_ns: int = 0
    broken: str | None = None
    """Why the chunks end before the file does."""
    changes: list[tuple[int, str]] = field(default_factory=list[tuple[int, str]])
    """(tick, text) of the events named 'segment'."""


def is_live(found: Scan) -> bool:
    """Whether a live recorder began this file."""
    for start, stop in found.metadata:
        with suppress(ValueError, struct.error):
            if fields.text(found.data, start, stop)[0] == START:
                return True
    return False


def is_whole(found: Scan) -> bool:
    """Whether the writer had finished the file, so that only its name is missing."""
    if found.end is not None or not found.sound or not finished(found):
        return False
    with suppress(ValueError, struct.error):
        return read_summary(found.data).messages > 0
    return False


def frames_of(found: Scan) -> int:
    """Frames of the Episode in a finished file."""
    return Episode.model_validate_json(episode_strings(found, found.where)["episode_json"]).frames


def rewrite(found: Scan, stream: IO[bytes]) -> tuple[Episode, str | None]:
    """Write all that is whole as a valid file, and return its Episode and why it is shorter than it was.

    Args:
        found: the leftover, scanned.
        stream: where to write; read again as a whole before this returns.

    Raises:
        RecordingError: nothing can be kept.
    """
    where, start = found.where, strings_of(found, found.where, START)
    kept, file = Kept(), None
    for sequence, topic, log_ns, publish_ns, payload, ends in messages_of(found, kept):
        if file is None:
            file = LiveFile({START: start}, attached_files(found), log_ns)
        file.add(topic, sequence, log_ns, publish_ns, payload)
        if ends:
            file.seal()
            stream.write(file.take())
    if file is None or not kept.frames:
        raise refuse(f"no whole tick; {kept.broken or found.end or 'nothing follows'}", where,
                     "drop it: there is nothing to keep")
    episode, lost, strings = _episode(found, kept, start)
    file.end({NAME: strings})
    stream.write(file.take())
    stream.flush()
    verify(Path(stream.name), file.assembly.counts, file.numbers)
    return episode, lost


def _episode(found: Scan, kept: Kept, start: dict[str, str]) -> tuple[Episode, str | None, dict[str, str]]:
    """The Episode that goes into the file, why it was cut, and the strings of its metadata."""
    if finished(found) and kept.broken is None:
        strings = episode_strings(found, found.where)
        return Episode.model_validate_json(strings["episode_json"]), None, strings
    seconds = (kept.last_ns - kept.first_ns) / 1e9
    why = kept.broken or "it was never closed"
    with reading(found.where, f"metadata record '{START}'"):
        episode = cut_off(Episode.model_validate_json(start["episode_json"]), kept.frames, kept.changes, why)
    known = {key: value for key, value in start.items() if key not in ("episode_json", SEAL)}
    strings = {**episode_metadata(episode, software={}, truncated=True), **known}
    return episode, f"{why}; {kept.frames} ticks kept, {seconds:.2f} s", {**strings, SEAL: seal(strings)}


def messages_of(found: Scan, kept: Kept) -> Iterator[tuple[int, str, int, int, bytes, bool]]:
    """Sequence, topic, log time, publish time, payload of all messages in whole chunks; whether it ends its chunk."""
    walk = Walk(lambda _: True)
    for chunk in found.chunks:
        walk.starts.clear()
        try:
            plain = unpack(chunk, found)
            with reading(found.where, f"chunk at byte {chunk.offset}"):
                walk.chunk(plain, 0)
        except RecordingError as error:
            kept.broken = error.what
            return
        places = sorted((at, number) for number, starts in walk.starts.items() for at in starts)
        for at, number in places:
            op, size, _, sequence, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(plain, at)
            if op != Op.MESSAGE or number not in walk.channels:
                kept.broken = f"chunk at byte {chunk.offset}: a message of no channel"
                return
            topic, payload = walk.channels[number][0], plain[at + MESSAGE_HEAD.size : at + 9 + size]
            _note(kept, topic, sequence, log_ns, payload)
            yield sequence, topic, log_ns, publish_ns, payload, at == places[-1][0]


def _note(kept: Kept, topic: str, sequence: int, log_ns: int, payload: bytes) -> None:
    kept.first_ns, kept.last_ns = kept.first_ns or log_ns, max(kept.last_ns, log_ns)
    if every_tick(topic):
        kept.frames = max(kept.frames, sequence + 1)
    elif topic == "/events":
        with suppress(ValueError):
            cursor = cdr.Cursor(payload)
            cursor.stamp()
            cursor.u8()
            if cursor.text() == "segment":
                kept.changes.append((sequence, cursor.text()))
