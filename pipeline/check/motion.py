"""Joints against their commands: standing still, running behind, going elsewhere, jumping out and back."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.check.following import Fit, best_lag, numbers, resample
from pipeline.check.signals import Column, Rows, Signals, Topic
from schemas.contract import Contract, Pair, Thresholds
from schemas.finding import Finding

LENGTHS = ("grip", "finger", "slide", "prismatic", "_x", "_y", "_z")
"""Parts of a column's name that say that it is a length, where no limit gives its unit."""


@dataclass(frozen=True, slots=True)
class Followed:
    """A measured signal and its command on one clock."""

    pair: Pair
    topic: Topic
    clock_s: Rows
    """Even, from the first moment that both know, shape (n,) [s]."""
    measured: Rows
    """Shape (n, d)."""
    commanded: Rows
    """Shape (n, d)."""
    names: tuple[str, ...]
    """Names of the measured columns."""

    @property
    def period_s(self) -> float:
        """Of the clock [s]."""
        return float(self.clock_s[1] - self.clock_s[0])


def unit_of(name: str, contract: Contract, reference: str) -> str:
    """'m' or 'rad': by the contract's limits, else by the column's name."""
    if (limit := contract.limits.get(reference, {}).get(name)) and limit.unit:
        return limit.unit
    return "m" if any(part in name.lower() for part in LENGTHS) else "rad"


def followed(signals: Signals, contract: Contract) -> Iterator[Followed]:
    """Every pair of the contract that this recording has, with at least 16 common rows."""
    for pair in contract.motion:
        measured, commanded = signals.find(pair.measured), signals.find(pair.commanded)
        if measured is None or commanded is None:
            continue
        columns = _columns(pair, measured[2], commanded[2])
        stamps = _stamps(measured[0], commanded[0])
        if columns is None or stamps is None:
            continue
        start, stop = max(s[0] for s in stamps), min(s[-1] for s in stamps)
        period = measured[0].period_s
        if not period > 0 or stop - start < 15 * period:
            continue
        clock = start + np.arange(int((stop - start) / period + 1e-6) + 1) * period
        own = [numbers(rows) for rows in columns[:2]]
        yield Followed(pair, measured[0], clock, resample(stamps[0], own[0], clock),
                       resample(stamps[1], own[1], clock), columns[2])


def _columns(pair: Pair, measured: Column, commanded: Column) -> tuple[Rows, Rows, tuple[str, ...]] | None:
    """Columns that belong together: as the pair says, else by equal names, else by place."""
    wanted = pair.columns or {n: n for n in measured.names if n in commanded.names}
    names = tuple(n for n, other in wanted.items() if n in measured.names and other in commanded.names)
    if names:
        own = [measured.names.index(n) for n in names]
        theirs = [commanded.names.index(wanted[n]) for n in names]
        return measured.rows[:, own], commanded.rows[:, theirs], names
    if measured.rows.shape[1] != commanded.rows.shape[1]:
        return None
    return measured.rows, commanded.rows, measured.names


def _stamps(measured: Topic, commanded: Topic) -> tuple[Rows, Rows] | None:
    """Both topics' stamps on one clock [s]: their headers' if both have them, else the recorder's."""
    if len(measured) < 16 or len(commanded) < 2:
        return None
    own, theirs = measured.log_ns, commanded.log_ns
    if measured.header_ns is not None and commanded.header_ns is not None:
        own, theirs = measured.header_ns, commanded.header_ns
    zero = int(own[0])
    return (own - zero) / 1e9, (theirs - zero) / 1e9


def frozen(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """A joint that stands still to the bit while its command moves."""
    for both in followed(signals, contract):
        if both.pair.kind != "target":
            continue
        for column, name in enumerate(both.names):
            limit = _moved(name, contract, both.pair.measured)
            start, stop = _standstill(both.measured[:, column], both.commanded[:, column], limit, _late(both, contract))
            span_s = (stop - start) * both.period_s
            if span_s >= contract.thresholds.frozen_s:
                moved = float(np.ptp(both.commanded[start:stop + 1, column]))
                yield Finding(check="frozen", what=f"{name} stands still for {span_s:.3g} s while its command moves by "
                              f"{moved:.3g}", where=f"{both.pair.measured} {name}", at_s=float(both.clock_s[start]),
                              frame=start, value=span_s, limit=contract.thresholds.frozen_s,
                              mend="look at the joint's encoder and driver; drop the episode")


def _moved(name: str, contract: Contract, reference: str) -> float:
    limits = contract.thresholds
    return limits.frozen_m if unit_of(name, contract, reference) == "m" else limits.frozen_rad


def _late(both: Followed, contract: Contract) -> int:
    """Rows by which a measurement may rightly run behind its command."""
    return math.ceil((both.pair.lag_s or (0.0, contract.thresholds.lag_high_s))[1] / both.period_s)


def _standstill(measured: Rows, commanded: Rows, moved: float, late: int) -> tuple[int, int]:
    """First and last row of the longest run of equal readings in which the command moved by `moved`, and `late` rows
    were left to follow it; 0, 0 if there is none."""
    edges = np.flatnonzero(np.abs(np.diff(measured)) > 1e-9) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges - 1, [len(measured) - 1]])
    best = (0, 0)
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if stop - start > max(best[1] - best[0], late) and np.ptp(commanded[start:stop + 1 - late]) >= moved:
            best = (start, stop)
    return best


def lag(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """How far the measured motion runs behind what was commanded, or, where they were shifted, ahead of it."""
    for both, fit, (low, high) in _fits(signals, contract):
        if fit.correlation < contract.thresholds.lag_correlation:
            continue
        half = both.period_s / 2
        if not low - half <= fit.lag_s <= high + half:
            side = "runs behind" if fit.lag_s > 0 else "runs ahead of"
            frames = fit.lag_s / both.period_s
            yield Finding(check="lag", what=f"{both.pair.measured} {side} {both.pair.commanded} by "
                          f"{abs(fit.lag_s):.3g} s ({abs(frames):.0f} frames)", where=both.pair.commanded,
                          value=fit.lag_s, limit=high if fit.lag_s > 0 else low,
                          mend="pair each action with the state that it was sent for; set motion.*.lag_s in the "
                          "contract for a slow robot")


def answer(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Whether the motion is the one that was commanded; actions that are turned around or shuffled get none."""
    limits = contract.thresholds
    for both, fit, _ in _fits(signals, contract):
        late = fit.correlation >= limits.lag_correlation  # then it does answer, and `lag` tells when
        if fit.within < limits.answer_correlation and not late:
            yield Finding(check="answer", severity=_sure(both.pair), what=f"{both.pair.measured} does not move as "
                          f"{both.pair.commanded} says: correlation {fit.within:.2f} at best",
                          where=both.pair.commanded, value=fit.within, limit=limits.answer_correlation,
                          mend="look at the order, the signs and the source of the actions; drop the episode, or set "
                          "thresholds.answer_correlation in the contract for a robot that is moved by others")


def _sure(pair: Pair) -> Literal["error", "warning"]:
    """A warning where it is a guess that the motion follows: actions of others may be speeds, torques, or relative."""
    return "warning" if pair.commanded == "action" and not pair.columns else "error"


def _fits(signals: Signals, contract: Contract) -> Iterator[tuple[Followed, Fit, tuple[float, float]]]:
    """Every pair that moves enough to tell, how its measurement follows, and the lags that it may have [s]."""
    limits = contract.thresholds
    for both in followed(signals, contract):
        low, high = both.pair.lag_s or (limits.lag_low_s, limits.lag_high_s)
        leader = np.diff(both.commanded, axis=0) if both.pair.kind == "target" else both.commanded[1:]
        moving = _moving(leader, both, contract)
        if not moving.any():
            continue
        fit = best_lag(leader[:, moving], np.diff(both.measured, axis=0)[:, moving], both.period_s,
                       allowed_s=(low, high), reach_s=max(1.0, high + 0.5))
        if fit is not None:
            yield both, fit, (low, high)


def _moving(leader: Rows, both: Followed, contract: Contract) -> NDArray[np.bool_]:
    """Columns whose command goes some way: in the others noise alone would be correlated, shape (d,)."""
    travelled = np.abs(leader).sum(axis=0)
    needed = np.array([_moved(name, contract, both.pair.measured) for name in both.names])
    return travelled > 2 * needed


def spikes(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """A reading that jumps out and back within one sample, and was not commanded to."""
    done = set[str]()
    for both in followed(signals, contract):
        reference = both.pair.measured
        if both.pair.kind != "target" or reference in done:
            continue
        done.add(reference)
        steps = np.diff(both.measured, axis=0)
        out = np.where(steps[:-1] * steps[1:] < 0, np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])), 0.0)
        out = np.where(_swing(both.commanded, _late(both, contract))[1:-1] < out / 2, out, 0.0)
        for column, name in enumerate(both.names):
            limit = _spike(contract.thresholds, unit_of(name, contract, reference))
            found = np.flatnonzero(out[:, column] > limit)
            if found.size:
                row = int(found[0]) + 1
                more = f", and {found.size - 1} more" if found.size > 1 else ""
                yield Finding(check="spikes", what=f"{name} jumps by {out[row - 1, column]:.3g} and back{more}",
                              where=f"{reference} {name}", at_s=float(both.clock_s[row]), frame=row,
                              value=float(out[row - 1, column]), limit=limit,
                              mend="look at the encoder's cable; drop the episode, or filter it before training")


def _swing(commanded: Rows, late: int) -> Rows:
    """How far each command went out and back again within the last `late` rows, shape (n, d); 0 where it went on.

    Half of its way beyond what brought it further: it may have come from somewhere else before.
    """
    padded = np.concatenate([np.repeat(commanded[:1], late, axis=0), commanded])
    windows = np.lib.stride_tricks.sliding_window_view(padded, late + 1, axis=0)
    way = np.abs(np.diff(windows, axis=2)).sum(axis=2)
    return (way - np.abs(windows[..., -1] - windows[..., 0])) / 2


def _spike(thresholds: Thresholds, unit: str) -> float:
    return thresholds.spike_m if unit == "m" else thresholds.spike_rad
