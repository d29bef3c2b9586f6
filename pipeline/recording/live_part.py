"""Where and when a live recording begins: a file that nobody else writes, and a clock that never goes back."""

import os
import time
from collections.abc import Callable
from pathlib import Path

from pipeline.errors import RecordingError
from pipeline.recording.dialect import TOPICS, every_tick, topic_type
from pipeline.recording.live_writer import close_quietly
from pipeline.recording.write import leave_reserve, lock, part_of


def steady_clock() -> Callable[[], int]:
    """Time of day at this call, going on with the monotonic clock [ns]: it never goes back."""
    base = time.time_ns() - time.monotonic_ns()
    return lambda: base + time.monotonic_ns()


def open_part(path: Path, reserve_bytes: int) -> int:
    """An empty .part, locked for as long as it is open: the lock tells recover that its writer lives."""
    if path.suffix != ".mcap":
        raise RecordingError(f"a recording is named .mcap, not {path.suffix!r}", where=path,
                             mend=f"write to {path.with_suffix('.mcap').name}")
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists():
        raise RecordingError("recording is already there", where=path, mend="name another file, or move this one away")
    leave_reserve(path.parent, 0, reserve_bytes)
    handle = os.open(part_of(path), os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o644)
    try:
        lock(handle, part_of(path))
        if os.fstat(handle).st_size:
            raise RecordingError("what a killed recording left has this name", where=part_of(path),
                                 mend=f"hardcase recover {path.parent}")
    except BaseException:
        close_quietly(handle)
        raise
    return handle


def checked_topic(topic: str, where: object) -> str:
    """The topic, or RecordingError: not of the dialect, or one of those that `tick` writes."""
    try:
        topic_type(topic)
    except KeyError:
        raise RecordingError(f"topic {topic} is not of the dialect", where=where,
                             mend=f"use one of: {', '.join(TOPICS)}") from None
    if every_tick(topic):
        raise RecordingError(f"topic {topic} is written once a tick", where=where, mend="give it to LiveRecorder.tick")
    return topic


def stopped(error: Exception, path: Path) -> RecordingError:
    """The error of a recording that ended before its time: what was written is kept."""
    reason = os.strerror(error.errno or 0) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
    return RecordingError(f"recording stopped: {reason}", where=part_of(path),
                          mend=f"free space or check the disk; keep what was written: hardcase recover {path.parent}")
