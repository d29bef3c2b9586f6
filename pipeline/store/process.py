"""Which process is which: enough to tell whether the holder of a lease still lives."""

import os
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from schemas.base import Frozen

PROC = Path("/proc")


class Holder(Frozen):
    """The process that holds the lease of a store."""

    run: str
    pid: int
    started: str
    """Start time of the process in clock ticks since boot (field 22 of proc_pid_stat(5)): pids are used again."""
    boot: str
    """Id of this boot of the machine."""
    namespace: str
    """The pid namespace: a container sees other pids than its host."""
    host: str
    since: str
    """Wall time of the taking, for people only."""
    command: str

    def __str__(self) -> str:
        return f"pid {self.pid} on {self.host} since {self.since} ({self.command}), run {self.run}"


def me(run: str, command: str | None) -> Holder:
    """This process as a holder."""
    return Holder(
        run=run,
        pid=os.getpid(),
        started=_started(os.getpid()),
        boot=_boot(),
        namespace=_namespace(),
        host=os.uname().nodename,
        since=datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
        command=command or " ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
    )


def state(holder: Holder) -> Literal["alive", "dead", "unseen"]:
    """Whether a holder lives, as far as this process can see; another container's is 'unseen'.

    Another boot means dead: a local disk is mounted by one machine at a time, and network disks are refused.
    """
    if holder.boot != _boot():
        return "dead"
    if holder.namespace != _namespace():
        return "unseen"
    try:
        os.kill(holder.pid, 0)
    except ProcessLookupError:
        return "dead"
    except PermissionError:
        pass  # another user's process lives
    return "alive" if _started(holder.pid) == holder.started else "dead"


def seconds() -> float:
    """A clock that all processes of a machine share, that never jumps and goes on in suspend [s]."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


def _started(pid: int) -> str:
    try:
        text = (PROC / str(pid) / "stat").read_text()
    except OSError:  # gone, or a system without /proc, where the pid alone has to do
        return ""
    after_name = text.rpartition(") ")[2].split()
    return "" if after_name[0] in "ZX" else after_name[19]  # a zombie has ended, only its parent has not looked


def _boot() -> str:
    path = PROC / "sys/kernel/random/boot_id"
    return path.read_text().strip() if path.exists() else ""


def _namespace() -> str:
    try:
        return str((PROC / "self/ns/pid").readlink())
    except OSError:
        return ""
