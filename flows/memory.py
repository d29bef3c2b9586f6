"""Peak memory of this process and all its children, by proportional set size, from /proc."""

import os
import threading
from pathlib import Path
from types import TracebackType
from typing import Self


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
        self.peak_mb = max(self.peak_mb, tree_pss_mb())
        return self.peak_mb

    def _sample(self) -> None:
        while not self._over.wait(self._period_s):
            self.look()
