"""Keep an encoder from taking the machine for itself."""

import os
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

THREADS = Path("/proc/self/task")


@contextmanager
def fair() -> Generator[Callable[[], None]]:
    """Yield what gives this process its usual scheduling back; also called at the end.

    SVT-AV1, run by root, asks for real-time priority, for its threads and for the one that opens it: whatever that
    starts afterwards inherits it and starves all else on the machine, a robot's control loop too. Nothing happens
    where the process was real-time before, or the system has no such policies.
    """
    usual = THREADS.is_dir() and os.sched_getscheduler(0) == os.SCHED_OTHER

    def calm() -> None:
        for thread in THREADS.iterdir() if usual else ():
            try:
                if os.sched_getscheduler(int(thread.name)) != os.SCHED_OTHER:
                    os.sched_setscheduler(int(thread.name), os.SCHED_OTHER, os.sched_param(0))
            except ProcessLookupError:  # it has ended meanwhile
                continue

    try:
        yield calm
    finally:
        calm()
