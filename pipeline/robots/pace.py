"""Pace: a control clock in wall time."""

import time
from collections.abc import Callable


class Pace:
    """Lets one control period pass at a time; monotonic, so that a corrected clock does not move the robot.

    A tick that comes late is not made up for by shorter ones: the next is due one period after it.

    Args:
        hz: control rate [Hz].
        speed: simulated seconds a wall second; 0 does not wait at all.
    """

    def __init__(self, hz: float, *, speed: float = 1.0, now: Callable[[], float] = time.monotonic,
                 sleep: Callable[[float], None] = time.sleep) -> None:
        self._period_s = 1 / hz / speed if speed > 0 else 0.0
        self._now, self._sleep = now, sleep
        self._due_s: float | None = None
        self.late = 0
        """Ticks that came over half a period late."""

    def restart(self) -> None:
        """Count from the next tick: somebody waited on purpose."""
        self._due_s = None

    def wait(self) -> None:
        """Sleep until the next tick is due."""
        if not self._period_s:
            return
        self._due_s = (self._now() if self._due_s is None else self._due_s) + self._period_s
        ahead_s = self._due_s - self._now()
        if ahead_s > 0:
            self._sleep(ahead_s)
        elif -ahead_s > self._period_s / 2:
            self.late += 1
            self._due_s = self._now()
