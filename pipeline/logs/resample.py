"""Resampling: which sample each frame uses, by a declared rule, and how far it lies from the frame.

hold     the last sample at or before the frame: what a controller would still know. Age 0 or more.
nearest  the sample closest in time, the earlier of two that are as close. It may lie after the frame.
linear   the line between the last sample at or before the frame and the first after it.

No rule invents a sample. Where none lies within the limit there is no frame: the caller parts or refuses the episode.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.logs.spool import Places, Rows, Samples, Stamps
from schemas.ingest import Rule

NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Picks:
    """What each of n frames uses of one topic."""

    below: Places
    """Place of the sample; for linear, of the one at or before the frame, shape (n,)."""
    above: Places
    """For linear, place of the one after; else as `below`, shape (n,)."""
    share: NDArray[np.float64]
    """How much `above` counts, 0 to 1, shape (n,)."""
    skew_ns: Stamps
    """Frame minus sample [ns]: positive where the sample is older. For linear, the distance of the farther of
    the two, 0 where a sample lies on the frame. Shape (n,)."""
    admissible: NDArray[np.bool_]
    """Whether there is a sample within the limit, shape (n,); the other columns mean nothing where there is none."""


def ticks(start_ns: int, first: int, stop: int, fps: int) -> Stamps:
    """Times of frames `first` to before `stop` of an episode [ns], each rounded half up, so that none drifts."""
    frames = np.arange(first, stop, dtype=np.int64)
    return start_ns + frames // fps * NS + (frames % fps * NS + fps // 2) // fps


def frames_until(start_ns: int, stop_ns: int, fps: int) -> int:
    """How many frames lie from `start_ns` to `stop_ns`, both included."""
    return 0 if stop_ns < start_ns else ((stop_ns - start_ns + 1) * fps - fps // 2 - 1) // NS + 1


def pick(samples: Samples, at: Stamps, rule: Rule, max_skew_s: float) -> Picks:
    """Choose the samples for frames at rising times [ns], shape (n,), at most `max_skew_s` away."""
    below = samples.before(at)
    above = below + 1
    has_below, has_above = below >= samples.first, above < samples.end
    if not len(samples):
        return Picks(below, below, np.zeros(at.size), np.zeros_like(at), np.zeros(at.size, np.bool_))
    age = at - samples.stamps(np.maximum(below, samples.first))
    zero = np.zeros(at.size)
    if rule == "hold":
        return _limited(Picks(below, below, zero, age, has_below), max_skew_s)
    ahead = samples.stamps(np.minimum(above, samples.end - 1)) - at
    if rule == "nearest":
        later = has_above & (~has_below | (ahead < age))
        chosen = np.where(later, above, below)
        return _limited(Picks(chosen, chosen, zero, np.where(later, -ahead, age), has_below | has_above), max_skew_s)
    exact = has_below & (age == 0)
    share = np.where(exact, 0.0, age / np.maximum(age + ahead, 1))
    skew = np.where(exact, 0, np.maximum(age, ahead))
    picks = Picks(below, np.where(exact, below, above), share, skew, has_below & (exact | has_above))
    return _limited(picks, max_skew_s)


def values(samples: Samples, picks: Picks, *, wrap: bool = False) -> Rows:
    """What n admissible picks say, shape (n, width).

    Args:
        samples: the topic's samples.
        picks: from `pick`, admissible ones only.
        wrap: values are angles [rad]: go the shorter way round. The result may lie outside -pi .. pi by one turn.
    """
    low = samples.values(picks.below)
    if not picks.share.any():
        return low
    difference = samples.values(picks.above) - low
    if wrap:
        difference = (difference + np.pi) % (2 * np.pi) - np.pi
    return np.where(picks.share[:, None] > 0, low + picks.share[:, None] * difference, low)


def only(picks: Picks, rows: NDArray[np.bool_]) -> Picks:
    """The picks of some frames."""
    return Picks(picks.below[rows], picks.above[rows], picks.share[rows], picks.skew_ns[rows], picks.admissible[rows])


def _limited(picks: Picks, max_skew_s: float) -> Picks:
    near = np.abs(picks.skew_ns) <= round(max_skew_s * NS)
    return Picks(picks.below, picks.above, picks.share, picks.skew_ns, picks.admissible & near)
