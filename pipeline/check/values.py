"""Values that cannot be: NaN, outside a joint's limits, in another unit."""

from collections.abc import Iterator

import numpy as np

from pipeline.check.following import correlation
from pipeline.check.motion import followed, unit_of
from pipeline.check.signals import Column, Rows, Signals, Topic
from schemas.contract import Contract, Limit
from schemas.finding import Finding

UNMEASURED = ("velocity", "effort", "covariance")
"""Fields that drivers fill with NaN where the robot has no such sensor."""
DEGREES, MILLIMETRES = 180 / np.pi, 1000.0
FULL_TURN, FAR_M = 2 * np.pi, 10.0
"""No revolute joint turns further [rad], no tabletop reaches further [m], where no limit is known."""
MOVED, TOGETHER = 0.01, 0.7
"""How far a signal must move [rad, m], and how much alike its command, before their ratio says something of units."""
NEAR = 0.25
"""How close the ratio of two signals must come to a factor between units, as a share of it."""


def finite(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """NaN and infinity, in any number of any topic."""
    for reference, topic, column in signals.numbers():
        bad = ~np.isfinite(column.rows)
        if not bad.any() or (bad.all() and any(part in reference for part in UNMEASURED)):
            continue
        row, place = (int(i) for i in np.argwhere(bad)[0])
        value = "NaN" if np.isnan(column.rows[row, place]) else "infinite"
        yield Finding(check="finite", what=f"{column.names[place]} is {value} at frame {row}, {int(bad.sum())} values "
                      "in all", where=f"{reference} {column.names[place]}", at_s=_at(signals, topic, row), frame=row,
                      value=float(bad.sum()), limit=0.0, mend="drop the episode: it cannot be trained on")


def limits(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Positions beyond a joint's limits, and speeds that it cannot reach."""
    for reference, names in contract.limits.items():
        found = signals.find(reference)
        if found is None:
            continue
        topic, _, column = found
        for name, limit in names.items():
            if name in column.names:
                values = column.rows[:, column.names.index(name)]
                yield from _beyond(signals, topic, reference, name, values, limit, contract)
                yield from _too_fast(signals, topic, reference, name, values, limit, contract)


def _beyond(signals: Signals, topic: Topic, reference: str, name: str, values: Rows, limit: Limit,
            contract: Contract) -> Iterator[Finding]:
    low = -np.inf if limit.low is None else limit.low
    high = np.inf if limit.high is None else limit.high
    known = [abs(edge) for edge in (low, high) if np.isfinite(edge)]
    span = high - low if len(known) == 2 else max(known, default=0.0)
    slack = contract.thresholds.limit_share * span
    outside = np.maximum(low - slack - values, values - high - slack)
    outside = np.where(np.isfinite(outside), outside, -np.inf)
    row = int(outside.argmax()) if outside.size else 0
    if outside.size and outside[row] > 0:
        edge = low if values[row] < low else high
        yield Finding(check="limits", what=f"{name} is {values[row]:.4g} {limit.unit or 'units'}, its limit {edge:.4g}",
                      where=f"{reference} {name}", at_s=_at(signals, topic, row), frame=row, value=float(values[row]),
                      limit=float(edge), mend="look at the joint's zero and scale, or set limits in the contract")


def _too_fast(signals: Signals, topic: Topic, reference: str, name: str, values: Rows, limit: Limit,
              contract: Contract) -> Iterator[Finding]:
    if limit.speed is None or len(values) < 2:
        return
    steps = np.diff(topic.seconds)
    usual = float(np.median(steps))  # a message that was late makes the next interval short, not the joint fast
    if usual <= 0:
        return
    speeds = np.abs(np.diff(values)) / np.maximum(steps, usual)
    speeds = np.where(np.isfinite(speeds), speeds, 0.0)
    row = int(speeds.argmax())
    if speeds[row] > limit.speed * (1 + contract.thresholds.limit_share):
        yield Finding(check="limits", what=f"{name} moves at {speeds[row]:.4g} {limit.unit or 'units'}/s, its limit "
                      f"{limit.speed:.4g}", where=f"{reference} {name}", at_s=_at(signals, topic, row), frame=row,
                      value=float(speeds[row]), limit=limit.speed,
                      mend="look for jumps of the encoder, or set limits.*.speed in the contract")


def units(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Degrees where radians belong, millimetres where metres do: by limits, and by a signal against its command."""
    told = set[tuple[str, str]]()
    for reference, names in contract.limits.items():
        found = signals.find(reference)
        for name, limit in names.items() if found is not None else ():
            if found is not None and name in found[2].names:
                finding = _foreign(reference, name, found[2], limit)
                if finding is not None:
                    told.add((reference, name))
                    yield finding
    for both in followed(signals, contract):
        if both.pair.kind != "target":
            continue
        spread = np.ptp(both.measured, axis=0), np.ptp(both.commanded, axis=0)
        for column, name in enumerate(both.names):
            unit = unit_of(name, contract, both.pair.measured)
            factor, wrong = (MILLIMETRES, "millimetres") if unit == "m" else (DEGREES, "degrees")
            small, large = sorted((float(spread[0][column]), float(spread[1][column])))
            at = both.pair.measured if spread[0][column] > spread[1][column] else both.pair.commanded
            told_already = {(both.pair.measured, name), (both.pair.commanded, name)} & told
            alike = correlation(both.measured[:, column], both.commanded[:, column])
            if small > MOVED and alike > TOGETHER and abs(large / small / factor - 1) < NEAR and not told_already:
                other = both.pair.commanded if at == both.pair.measured else both.pair.measured
                yield Finding(check="units", what=f"{name} looks like {wrong}: it moves {large / small:.0f} times as "
                              f"far as in {other}", where=f"{at} {name}", value=large / small, limit=1.0,
                              mend="convert it when it is recorded or ingested (unit: deg_to_rad, mm_to_m)")


def _foreign(reference: str, name: str, column: Column, limit: Limit) -> Finding | None:
    """A finding if the values fit the limit only in another unit."""
    values = np.abs(column.rows[:, column.names.index(name)])
    top = float(np.max(values, where=np.isfinite(values), initial=0.0))
    edges = [abs(x) for x in (limit.low, limit.high) if x is not None]
    if limit.unit == "rad":
        edge, factor, wrong = max(edges, default=FULL_TURN), DEGREES, "degrees"
        edge = max(edge, FULL_TURN)  # a little beyond a limit is the business of `limits`
    elif limit.unit == "m":
        edge, factor, wrong = max(edges, default=FAR_M), MILLIMETRES, "millimetres"
        edge = max(3 * edge, 0.3)
    else:
        return None
    if top <= edge or top / factor > edge:
        return None
    return Finding(check="units", what=f"{name} looks like {wrong}: it reaches {top:.4g}", where=f"{reference} {name}",
                   value=top, limit=edge, mend="convert it when it is recorded or ingested (unit: "
                   f"{'deg_to_rad' if wrong == 'degrees' else 'mm_to_m'})")


def _at(signals: Signals, topic: Topic, row: int) -> float | None:
    return signals.at_s(int(topic.log_ns[row])) if not topic.tabled else None
