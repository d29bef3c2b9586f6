"""How far one signal runs behind another: cross-correlation on a common clock."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

type Rows = NDArray[np.float64]

ABSURD = 1e12
"""Beyond any position, speed or torque in any unit; squares of what lies below do not overflow."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Where two signals fit best."""

    lag_s: float
    """How far the second runs behind the first [s]; negative where it runs ahead."""
    correlation: float
    """At that lag, -1 to 1."""
    within: float
    """Best correlation at a lag that was allowed."""


def numbers(rows: Rows) -> Rows:
    """The rows with 0 for what is no number, or none of this world: to tell of it is the business of other checks."""
    return np.where(np.abs(rows) < ABSURD, rows, 0.0)


def resample(stamps_s: Rows, rows: Rows, clock_s: Rows) -> Rows:
    """Rows at other times, linear between their own; stamps that do not rise are left out."""
    keep = np.concatenate([[True], np.diff(np.maximum.accumulate(stamps_s)) > 0])
    out = np.empty((len(clock_s), rows.shape[1]))
    for k in range(rows.shape[1]):
        out[:, k] = np.interp(clock_s, stamps_s[keep], rows[keep, k])
    return out


def correlation(one: Rows, other: Rows) -> float:
    """Pearson's correlation of all numbers of two arrays, -1 to 1; 0 where one of them does not change."""
    a, b = one.ravel() - one.mean(), other.ravel() - other.mean()
    scale = float(np.sqrt(float(a @ a) * float(b @ b)))
    return float(a @ b) / scale if scale > 0 else 0.0


def best_lag(leader: Rows, follower: Rows, period_s: float, *, allowed_s: tuple[float, float],
             reach_s: float = 1.0) -> Fit | None:
    """The lag at which a follower fits its leader best, over all columns together.

    Pearson's correlation at every whole lag up to `reach_s`, each column scaled by its own deviation; the top is
    refined by a parabola through its neighbours. Columns in which either stands still say nothing and are left out.

    Args:
        leader, follower: rates of change on one even clock, shape (n, d).
        period_s: of that clock [s].
        allowed_s: lags that are legal [s]; `within` is the best of them.
        reach_s: lags looked at, to both sides [s]; never more than a third of the signal.

    Returns:
        None where nothing moves, or there are fewer than 16 rows.

    Source: Knapp and Carter 1976, "The generalized correlation method for estimation of time delay".
    """
    n = len(leader)
    reach = min(round(reach_s / period_s), n // 3)
    moving = (leader.std(axis=0) > 1e-9) & (follower.std(axis=0) > 1e-9)
    if n < 16 or reach < 1 or not moving.any():
        return None
    a, b = (_scaled(rows[:, moving]) for rows in (leader, follower))
    lags = np.arange(-reach, reach + 1)
    scores = np.array([_score(a, b, int(lag)) for lag in lags])
    top = int(scores.argmax())
    low, high = (round(edge / period_s) for edge in allowed_s)
    inside = scores[(lags >= low) & (lags <= high)]
    return Fit((lags[top] + _peak(scores, top)) * period_s, float(scores[top]),
               float(inside.max()) if inside.size else -1.0)


def _scaled(rows: Rows) -> Rows:
    return (rows - rows.mean(axis=0)) / rows.std(axis=0)


def _score(a: Rows, b: Rows, lag: int) -> float:
    """Correlation of a with b moved forward by `lag` rows, over what overlaps."""
    n = len(a)
    first, second = a[max(0, -lag):n - max(0, lag)], b[max(0, lag):n - max(0, -lag)]
    scale = np.sqrt((first ** 2).sum() * (second ** 2).sum())
    return float((first * second).sum() / scale) if scale > 0 else 0.0


def _peak(scores: Rows, top: int) -> float:
    """How far the true top lies from the best whole lag, -0.5 to 0.5."""
    if not 0 < top < len(scores) - 1:
        return 0.0
    left, middle, right = scores[top - 1:top + 2]
    bend = left - 2 * middle + right
    return float(0.5 * (left - right) / bend) if bend < 0 else 0.0
