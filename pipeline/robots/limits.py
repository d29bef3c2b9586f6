"""Limits: what may be sent to a robot; checked before anything moves, whoever asked for it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import RobotError
from pipeline.protocols import Array, Signals

PATIENCE = 3
"""Values that are not finite, tick after tick, before the robot is stopped for good."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of one action, column by column, in the columns' own units."""

    low: Array
    """Least value that may be sent, shape (k,)."""
    high: Array
    """Largest value that may be sent, shape (k,)."""
    step: Array
    """Largest change from one tick to the next, shape (k,); infinite where a column is a step itself."""


@dataclass(frozen=True, slots=True)
class Checked:
    """What may be sent, and what had to be done to it."""

    action: Array
    """Shape (k,), finite and within every limit."""
    note: str
    """What was wrong with what was asked for; empty where nothing was."""


class Guard:
    """Stands between whoever commands and the robot; remembers what was sent last.

    Args:
        name: of the robot, for errors.
        signals: names of its columns.
        limits: its bounds.
        hold: what keeps the robot where it is; sent in place of what cannot be sent, shape (k,).

    Raises:
        RobotError: `hold` is not finite.
    """

    def __init__(self, name: str, signals: Signals, limits: Limits, hold: Array) -> None:
        self._check_hold(name, hold)
        self._name, self._signals, self._limits = name, signals, limits
        self._last, self._bad = hold.copy(), 0

    def check(self, action: NDArray[np.generic], hold: Array) -> Checked:
        """What of this action may be sent.

        The order is shape, finite, range, step: a later test never sees what an earlier one refused.

        Args:
            action: as it was asked for, shape (k,).
            hold: what keeps the robot where it is now, shape (k,).

        Raises:
            RobotError: wrong shape, or not finite for the third time in a row, or `hold` is not finite either.
        """
        names = self._signals.action
        if action.shape != (len(names),):
            raise RobotError(f"action has {action.size} values, robot {self._name!r} expects {len(names)}",
                             where=f"action of robot {self._name}", mend=f"send {', '.join(names)}")
        values = action.astype(np.float64)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            return self._held(names, values, int(bad[0]), hold)
        self._bad = 0
        limits = self._limits
        bounded = np.clip(values, limits.low, limits.high)
        bounded = np.clip(bounded, self._last - limits.step, self._last + limits.step)
        self._last = bounded
        cut = [name for name, asked, sent in zip(names, values, bounded, strict=True) if abs(sent - asked) > 1e-9]
        return Checked(bounded, f"limited {', '.join(cut)}" if cut else "")

    def _held(self, names: tuple[str, ...], values: Array, k: int, hold: Array) -> Checked:
        self._bad += 1
        what = f"action[{k}] ({names[k]}) is {'NaN' if np.isnan(values[k]) else 'Inf'}"
        if self._bad >= PATIENCE:
            raise RobotError(f"{what} for {PATIENCE} ticks; the robot was stopped", where=f"robot {self._name}",
                             mend="mend what commands it (policy or input device), then start again")
        self._check_hold(self._name, hold)
        self._last = hold.copy()
        return Checked(hold.copy(), f"{what}; held still")

    @staticmethod
    def _check_hold(name: str, hold: Array) -> None:
        """What is sent in place of a bad value must not be one itself."""
        if not np.isfinite(hold).all():
            raise RobotError("where the robot is to be held is not known", where=f"robot {name}",
                             mend="check its encoders and calibration")
