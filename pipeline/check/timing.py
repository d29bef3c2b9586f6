"""Rates, gaps, jitter, and clocks that are off, drift or jump."""

from collections.abc import Iterator

import numpy as np

from pipeline.check.signals import Ns, Signals, Topic
from schemas.contract import Contract, TopicRule
from schemas.finding import Finding

DAY_NS = 86_400_000_000_000
SECOND_NS = 1e9
PAUSE_S = 3.0
"""Silence that a robot which waits may keep between two numbers that follow each other [s]."""


def rates(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Messages a second of every topic that the contract gives a rate for."""
    for topic, rule in _ruled(signals, contract):
        span_s = (int(topic.log_ns[-1]) - int(topic.log_ns[0])) / SECOND_NS
        if rule.rate_hz is None or span_s <= 0:
            continue
        rate = (len(topic) - 1) / span_s
        if abs(rate / rule.rate_hz - 1) > rule.rate_tolerance:
            yield Finding(check="rates", what=f"{rate:.4g} messages a second, {rule.rate_hz:g} are expected",
                          where=topic.name, value=rate, limit=rule.rate_hz,
                          mend="look for a slow sensor or a full queue, or set topics.*.rate_hz in the contract")


def gaps(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """The longest silence of every topic that speaks at a rate, by the recorder's clock and by its own."""
    limits = contract.thresholds
    for topic in _steady(signals):
        rule = contract.topics.get(topic.name)
        limit = rule.max_gap_s if rule and rule.max_gap_s else max(limits.gap_s, limits.gap_periods * topic.period_s)
        for clock, stamps in _clocks(topic):
            steps = np.diff(stamps) / SECOND_NS
            worst = int(steps.argmax())
            if steps[worst] > limit:
                more = int((steps > limit).sum()) - 1
                yield Finding(check="gaps", what=f"silent for {steps[worst]:.3g} s by its {clock} stamps"
                              + (f", and {more} more gaps" if more else ""), where=topic.name,
                              at_s=signals.at_s(int(topic.log_ns[worst])), frame=worst, value=float(steps[worst]),
                              limit=limit, mend="cut the episode at the gap or drop it; look at the recorder's dropped "
                              "messages")
                break


def jitter(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """How unevenly a topic speaks: the interval that 95 of 100 keep to, against its period.

    What a live recording of ours was late by without harm (see own_time) is told as a warning.
    """
    for fact in ("paused", "late"):
        if what := signals.faults.get(fact):
            yield Finding(check="jitter", severity="warning", what=what, where=signals.name,
                          mend="give the recorder a core of its own; fewer or smaller pictures")
    for topic in _steady(signals):
        rule = contract.topics.get(topic.name)
        period = 1 / rule.rate_hz if rule and rule.rate_hz else topic.period_s
        share = contract.thresholds.camera_jitter_periods if topic.name in signals.cameras \
            else contract.thresholds.jitter_periods
        limit = rule.jitter_s if rule and rule.jitter_s else share * period
        off = np.abs(np.diff(topic.log_ns) / SECOND_NS - topic.period_s)
        spread = float(np.quantile(off, 0.95))
        if spread > limit:
            yield Finding(check="jitter", what=f"intervals of {topic.period_s * 1e3:.3g} ms are off by "
                          f"{spread * 1e3:.3g} ms and more", where=topic.name, at_s=None,
                          frame=int(off.argmax()), value=spread, limit=limit,
                          mend="give the recorder a core of its own, or stamp at the sensor")


def clock_offset(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Header stamps against log time: one topic against the others, and all against the contract's limit."""
    middles = {t.name: float(np.median(off)) / SECOND_NS for t, off in _offsets(signals)}
    common = float(np.median(list(middles.values()))) if middles else 0.0
    for name, middle in middles.items():
        others, limit = middle - common, contract.thresholds.offset_s
        if abs(others) > limit and len(middles) > 1:
            yield Finding(check="clock-offset", what=f"stamps lie {others:+.3g} s off those of the other topics",
                          where=name, value=others, limit=limit,
                          mend="synchronise the clocks (chrony, PTP), or declare the topic's clock when it is ingested")
        elif contract.max_offset_s is not None and abs(middle) > contract.max_offset_s:
            yield Finding(check="clock-offset", what=f"stamps lie {middle:.3g} s behind the recorder's clock",
                          where=name, value=middle, limit=contract.max_offset_s,
                          mend="synchronise the clocks (chrony, PTP), or set max_offset_s in the contract")


def clock_drift(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """How far header stamps and log time drift apart over the recording.

    A line is fitted to their difference; it counts where it exceeds the scatter around it six times, so that a
    late message of a busy computer is no drift.
    """
    for topic, offsets in _offsets(signals):
        if len(topic) < 20 or _jumps(offsets, contract.thresholds.jump_s).size:
            continue
        at = (topic.log_ns - topic.log_ns[0]) / SECOND_NS
        off = (offsets - offsets[0]) / SECOND_NS
        centred = at - at.mean()
        slope = float(centred @ off / max(centred @ centred, 1e-12))
        drift, scatter = slope * float(at[-1]), float(np.std(off - off.mean() - slope * centred))
        limit = contract.thresholds.drift_s
        if abs(drift) > limit and abs(drift) > 6 * scatter:
            yield Finding(check="clock-drift", what=f"its clock drifts {drift:+.3g} s in {at[-1]:.3g} s "
                          f"({slope * 1e6:+.3g} ppm)", where=topic.name, value=drift, limit=limit,
                          mend="synchronise the clocks (chrony, PTP) while recording")


def clock_jump(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Time that goes back, and one clock that leaves the other at a bound."""
    mend = "record with log_time from one monotonic clock, or drop the episode"
    for topic in signals.topics.values():
        back = np.flatnonzero(np.diff(topic.log_ns) < 0)
        if back.size and not topic.tabled:
            k = int(back[0])
            seconds = (int(topic.log_ns[k]) - int(topic.log_ns[k + 1])) / SECOND_NS
            yield Finding(check="clock-jump", what=f"goes back {seconds:.3g} s at message {k + 1}", where=topic.name,
                          at_s=signals.at_s(int(topic.log_ns[k])), frame=k + 1, value=-seconds, limit=0.0, mend=mend)
    told = set[str]()
    for topic in _steady(signals):
        k = _numbered_on(topic, contract.thresholds.jump_s)
        if k is not None:
            seconds = (int(topic.log_ns[k]) - int(topic.log_ns[k - 1])) / SECOND_NS
            told.add(topic.name)
            yield Finding(check="clock-jump", what=f"jumps by {seconds:+.4g} s at message {k}, and none is missing",
                          where=topic.name, at_s=signals.at_s(int(topic.log_ns[k - 1])), frame=k, value=seconds,
                          limit=contract.thresholds.jump_s, mend=mend)
    for topic, offsets in _offsets(signals, other_epochs=True):
        found = _jumps(offsets, contract.thresholds.jump_s)
        if found.size and topic.name not in told and not (np.diff(topic.log_ns) < 0).any():
            k = int(found[0])
            seconds = (int(offsets[k + 1]) - int(offsets[k])) / SECOND_NS
            yield Finding(check="clock-jump", what=f"log time and stamps part by {seconds:+.4g} s at message {k + 1}",
                          where=topic.name, at_s=signals.at_s(int(topic.log_ns[k])), frame=k + 1, value=seconds,
                          limit=contract.thresholds.jump_s, mend=mend)


def _ruled(signals: Signals, contract: Contract) -> Iterator[tuple[Topic, TopicRule]]:
    """Topics of the contract that are there and have stamps of their own."""
    for name, rule in contract.topics.items():
        topic = signals.topics.get(name)
        if topic is not None and len(topic) > 2 and not topic.tabled:
            yield topic, rule


def _steady(signals: Signals) -> Iterator[Topic]:
    return (t for t in signals.topics.values() if t.steady and not t.tabled)


def _clocks(topic: Topic) -> Iterator[tuple[str, Ns]]:
    yield "log", topic.log_ns
    if topic.header_ns is not None:
        yield "header", topic.header_ns


def _offsets(signals: Signals, *, other_epochs: bool = False) -> Iterator[tuple[Topic, Ns]]:
    """Log time minus stamp of every message [ns], of topics with at least three; stamps of another epoch than the
    recorder's (simulated time from 0) only if asked for: a jump shows in them too, an offset does not."""
    for topic in signals.topics.values():
        stamps = topic.header_ns if topic.header_ns is not None else topic.publish_ns
        if len(topic) < 3 or topic.tabled or not stamps.any():
            continue
        offsets = topic.log_ns - stamps
        if other_epochs or abs(float(np.median(offsets))) < DAY_NS:
            yield topic, offsets


def _numbered_on(topic: Topic, limit_s: float) -> int | None:
    """The first message after a silence in which no number was left out, so that it was the clock that moved; a
    sensor that pauses for less than three seconds is left to `gaps`."""
    if topic.sequence is None or not topic.sequence.any():
        return None
    steps = np.diff(topic.sequence)
    even = steps == np.median(steps)
    silent = np.diff(topic.log_ns) > max(limit_s, PAUSE_S) * SECOND_NS
    at = np.flatnonzero(silent & even)
    return int(at[0]) + 1 if at.size and even.mean() > 0.8 else None


def _jumps(offsets: Ns, limit_s: float) -> Ns:
    return np.flatnonzero(np.abs(np.diff(offsets)) > limit_s * SECOND_NS)
