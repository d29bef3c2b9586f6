"""Read a finished recording again, every byte, before it may be called whole."""

import os
from collections.abc import Mapping
from pathlib import Path

from pipeline.files import sha256
from pipeline.recording.scan import load, scan
from pipeline.recording.series import collect
from pipeline.recording.summary import read_summary


def verify(part: Path, counts: Mapping[int, int] | None = None, numbers: Mapping[str, int] | None = None) -> str:
    """The file's sha256, once all of it reads back; ValueError or RecordingError where it does not.

    Every chunk is unpacked and compared with its CRC, the data section with its own, and messages are counted a
    topic, against what was written and against the summary.

    Args:
        part: the file, written to the system.
        counts: channel -> messages that were written, where that is known.
        numbers: topic -> channel.
    """
    _forget(part)
    data = load(part)
    found = scan(data, part)
    if found.end is not None or not found.sound:
        raise ValueError(found.end or "data section: CRC mismatch")
    messages = collect(found, lambda _: False, tolerant=False)
    for topic, number in (numbers or {}).items():
        read, written = messages.counts.get(number, 0), (counts or {}).get(number, 0)
        if read != written:
            raise ValueError(f"{read} messages on {topic} of {written}")
    summary = read_summary(data)
    if summary.counts != messages.counts or summary.messages != messages.total:
        raise ValueError(f"summary lists {summary.messages} messages, data has {messages.total}")
    return sha256(data)


def _forget(part: Path) -> None:
    """Sync the file and drop it from the page cache: the disk is to be asked, not the memory it was written from."""
    handle = os.open(part, os.O_RDONLY)
    try:
        os.fsync(handle)  # what is not on the disk yet cannot be dropped
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
    finally:
        os.close(handle)
