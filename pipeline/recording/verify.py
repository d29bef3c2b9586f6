"""Read a finished recording again, every byte, before it may be called whole."""

import os
from collections.abc import Mapping
from pathlib import Path

from pipeline.files import sha256
from pipeline.recording.scan import load, scan
from pipeline.recording.series import collect
from pipeline.recording.summary import read_summary


def verify(part: Path, counts: Mapping[int, int], numbers: Mapping[str, int]) -> str:
    """The file's sha256, once all of it reads back; ValueError or RecordingError where it does not.

    Every chunk is unpacked and compared with its CRC, the data section with its own, and messages are counted a
    topic, against what was written and against the summary.

    Args:
        part: the file, synced.
        counts: channel -> messages that were written.
        numbers: topic -> channel.
    """
    _forget(part)
    data = load(part)
    found = scan(data, part)
    if found.end is not None or not found.sound:
        raise ValueError(found.end or "data section: CRC mismatch")
    messages = collect(found, lambda _: False, tolerant=False)
    read = {topic: messages.counts.get(number, 0) for topic, number in numbers.items()}
    for topic, number in numbers.items():
        if read[topic] != counts.get(number, 0):
            raise ValueError(f"{read[topic]} messages on {topic} of {counts.get(number, 0)}")
    summary = read_summary(data)
    if summary.counts != dict(counts) or summary.messages != messages.total:
        raise ValueError(f"summary lists {summary.messages} messages, data has {messages.total}")
    return sha256(data)


def _forget(part: Path) -> None:
    """Drop the file from the page cache, so that the disk is asked and not the memory it was written from."""
    handle = os.open(part, os.O_RDONLY)
    try:
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
    finally:
        os.close(handle)
