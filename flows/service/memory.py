"""Memory of this process and all its children: what they hold at most, and giving back what they no longer need."""

import ctypes
import os
import threading
from pathlib import Path
from types import TracebackType
from typing import Self

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
"""Parameters of mallopt, from glibc's malloc.h."""
OWN_MAPPING_BYTES = 1 << 20
"""Arrays from this size on get a mapping of their own, which goes back to the system with them."""
ARENAS = 2
"""Heaps that threads share; by default a new thread opens one of its own, up to eight a core."""


def frugal() -> None:
    """Have glibc keep less for later; call before threads start. Nothing happens with another C library.

    Left alone it raises its threshold for own mappings to 32 MB as soon as large arrays are freed; from then on
    the arrays of one stage leave holes in the heap that the next stage cannot use.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for parameter, value in ((M_ARENA_MAX, ARENAS), (M_MMAP_THRESHOLD, OWN_MAPPING_BYTES),
                                 (M_TRIM_THRESHOLD, 4 * OWN_MAPPING_BYTES)):
            mallopt(parameter, value)


def give_back() -> None:
    """Return what is free within glibc's heaps to the system; some milliseconds."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def tree(root: int) -> list[int]:
    """A process and everything that it, or what it started, has started, as far as it is alive.

    Reads every /proc/PID/stat, because not every kernel lists children under /proc/PID/task.
    """
    parents = {int(entry.name): _parent(entry) for entry in Path("/proc").iterdir() if entry.name.isdigit()}
    found = [root]
    for pid in found:  # grows while it is walked
        found.extend(child for child, parent in parents.items() if parent == pid)
    return found


def _parent(entry: Path) -> int:
    try:
        return int((entry / "stat").read_text().rpartition(")")[2].split()[1])
    except (OSError, IndexError):
        return 0  # it ended while we looked


def pss_mb(pid: int) -> float:
    """Proportional set size of one process [MB]: shared pages counted by share; 0 if it is gone."""
    try:
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) * 1024 / 1e6
    except OSError:
        pass
    return 0.0


def tree_pss_mb(root: int | None = None) -> float:
    """Summed proportional set size of a process and its children [MB]."""
    return sum(pss_mb(pid) for pid in tree(root or os.getpid()))


class MemoryWatch:
    """Samples the process tree in a thread while the block runs; `peak_mb` is the largest sum seen."""

    def __init__(self, period_s: float = 0.5) -> None:
        self.peak_mb = 0.0
        self._period_s = period_s
        self._peak = threading.Lock()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._sample, name="memory-watch", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join(timeout=2)
        self.look()

    def look(self) -> float:
        """Take one more sample now; returns the peak so far [MB]."""
        now_mb = tree_pss_mb()
        with self._peak:  # a slower look must not put back an older peak
            self.peak_mb = max(self.peak_mb, now_mb)
            return self.peak_mb

    def _sample(self) -> None:
        while not self._over.wait(self._period_s):
            self.look()
