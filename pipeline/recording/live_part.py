"""Where and when a live recording begins: a file that nobody else writes, and a clock that never goes back."""

import os
import time
from collections.abc import Callable
from pathlib import Path

from pipeline.errors import RecordingError
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
