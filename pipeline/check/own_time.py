"""Our own live recordings in the time of their robot: what made them uneven, and is no fault of theirs, taken out."""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from pipeline.check.signals import Ns, Signals, Topic

STATE = "/sim/state"
"""Topic that only a simulated robot has."""
UNEVEN = 0.1
"""Share of a period that a tick may be early or late without being looked at."""
PARTED_S, PAUSED_S = 0.5, 60.0
"""A busy computer parts stamp and arrival of a tick or two, and for less than a minute: what parts them for good, or
takes longer, is a clock [s]."""
TICKED = 0.9
"""Share of pictures whose ticks have to be there; a killed recording may end with pictures of the next."""


def in_own_time(signals: Signals) -> Signals:
    """The recording as its robot lived through it; what was taken out stands in `faults`, as 'paused' and 'late'.

    A simulated robot stands still while its loop waits for a busy computer, or is driven in slow motion: every stamp
    is moved to the robot's time, which passes by one period from tick to tick, whatever the clock on the wall did.
    Pictures that bear the very stamps of ticks show those ticks, however late they were rendered: they are taken as
    if they had arrived with them.
    """
    if signals.episode is None:
        return signals
    return _pictures_at_ticks(_without_pauses(signals, signals.episode.control_hz))


def _without_pauses(signals: Signals, control_hz: float) -> Signals:
    state = signals.topics.get(STATE)
    if state is None or state.sequence is None or len(state) < 8:
        return signals
    wall, numbers, period = state.publish_ns, np.diff(state.sequence), 1e9 / control_hz
    steps = np.diff(wall)
    if (numbers <= 0).any() or (steps <= 0).any():
        return signals  # out of order: no clock to go by
    late = steps - numbers * period
    if np.abs(late).max() < UNEVEN * period or late.max() > PAUSED_S * 1e9 or _parted(signals):
        return signals
    start, seconds = int(wall[0]), (wall - wall[0]).astype(np.float64)
    own = (state.sequence - state.sequence[0]) * period

    def moved(stamps: Ns) -> Ns:
        """Stamps on the wall's clock as the robot's time [ns]."""
        at = (stamps - start).astype(np.float64)
        inside = cast(NDArray[np.float64], np.interp(at, seconds, own))
        whole = np.where(at < 0, at, np.where(at > seconds[-1], own[-1] + at - seconds[-1], inside))
        near = np.abs(stamps - start) < 10 * max(seconds[-1], 1e9)  # another epoch, or never set: not on this clock
        return np.where(near, start + np.round(whole).astype(np.int64), stamps)

    text = (f"the loop was late at {int((late > period / 2).sum())} of {len(late)} ticks, by {late.max() / 1e9:.3g} s "
            "at most; simulated time stood still meanwhile")
    return replace(signals, topics={n: _topic(t, moved) for n, t in signals.topics.items()},
                   cameras={n: replace(c, stamps_ns=moved(c.stamps_ns)) for n, c in signals.cameras.items()},
                   faults=dict(signals.faults) | ({"paused": text} if (late > period / 2).any() else {}))


def _parted(signals: Signals) -> bool:
    """Whether arrivals leave their stamps for good: then a clock jumped; one late tick alone is a wait."""
    for name, topic in signals.topics.items():
        if name not in signals.cameras and topic.steady and topic.header_ns is not None and len(topic) >= 8:
            apart, quarter = topic.log_ns - topic.header_ns, len(topic) // 4
            if abs(float(np.median(apart[-quarter:]) - np.median(apart[:quarter]))) > PARTED_S * 1e9:
                return True
    return False


def _topic(topic: Topic, moved: Callable[[Ns], Ns]) -> Topic:
    return replace(topic, log_ns=moved(topic.log_ns), publish_ns=moved(topic.publish_ns),
                   header_ns=None if topic.header_ns is None else moved(topic.header_ns))


def _pictures_at_ticks(signals: Signals) -> Signals:
    topics, late_s = dict(signals.topics), 0.0
    others = [t for n, t in topics.items() if n not in signals.cameras and t.header_ns is not None and t.steady]
    for name in signals.cameras.keys() & topics.keys():
        topic = topics[name]
        arrivals = next((a for o in others if (a := _arrivals(topic, o)) is not None), None)
        if arrivals is not None:
            late_s = max(late_s, float((topic.log_ns - arrivals).max()) / 1e9)
            topics[name] = replace(topic, log_ns=arrivals)
    limit = 2 / signals.episode.control_hz if signals.episode else 0.0
    told = {"late": f"pictures arrived up to {late_s:.3g} s after their ticks; they bear the stamps of these"}
    return replace(signals, topics=topics, faults=dict(signals.faults) | (told if late_s > limit else {}))


def _arrivals(pictures: Topic, ticks: Topic) -> Ns | None:
    """When the ticks of these pictures arrived [ns]; None where they do not bear the stamps of these ticks."""
    if pictures.header_ns is None or pictures.sequence is None or ticks.header_ns is None or ticks.sequence is None:
        return None
    if len(ticks) < 8 or (np.diff(ticks.sequence) <= 0).any() or (np.diff(pictures.sequence) <= 0).any():
        return None
    at = np.searchsorted(ticks.sequence, pictures.sequence).clip(max=len(ticks) - 1)
    there = ticks.sequence[at] == pictures.sequence
    if there.mean() < TICKED or (ticks.header_ns[at] != pictures.header_ns)[there].any():
        return None
    usual = int(np.median(ticks.log_ns - ticks.header_ns))
    return np.where(there, ticks.log_ns[at], pictures.header_ns + usual)


def told_missing(signals: Signals, topic: str) -> int:
    """Pictures that the recorder itself says it did not take or had to drop; 0 for recordings of others."""
    record, name, found = signals.metadata.get("episode", {}), topic.split("/")[2:3], 0
    for key, counted in (("dropped", topic), ("skipped", name[0] if name else "")):
        with suppress(ValueError, TypeError, AttributeError):
            found += int(json.loads(record.get(key, "{}")).get(counted, 0))
    return found
