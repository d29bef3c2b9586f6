"""Faults of time: silences, uneven rates, and clocks that are off, drift or jump."""

import numpy as np

from pipeline.selftest.log import Log

type Rng = np.random.Generator

STATES, COMMANDS = "/joint_states", "/joint_commands"
SECOND_NS = 1_000_000_000


def recorder_stalls(log: Log, rng: Rng) -> None:
    """Nothing at all is recorded for 0.5 s."""
    start = _moment(log, rng)
    log.drop(lambda m: start <= log.at_s(m) < start + 0.5)


def topic_stalls(log: Log, rng: Rng) -> None:
    """The joints are silent for 0.5 s, everything else goes on; the driver numbers on as if nothing had been."""
    start = _moment(log, rng)
    lost = [m for m in log.of(STATES) if start <= log.at_s(m) < start + 0.5]
    log.drop(lambda m: any(m is gone for gone in lost))
    _number_on(log, STATES)


def _moment(log: Log, rng: Rng) -> float:
    """Somewhere in the middle [s], 0.5 s and more from both ends."""
    return float(rng.uniform(0.2, 0.8) * (log.span_s - 0.6) + 0.05)


def _number_on(log: Log, topic: str) -> None:
    messages = log.of(topic)
    for k, message in enumerate(messages):
        message.sequence = messages[0].sequence + k


def slow_topic(log: Log, rng: Rng) -> None:
    """The joints are measured at half of their rate, evenly, and numbered without a hole."""
    odd = {id(m) for m in log.of(STATES)[1::2]}
    log.drop(lambda m: id(m) in odd)
    _number_on(log, STATES)


def bursts(log: Log, rng: Rng) -> None:
    """Joint messages arrive in bursts of three, as over a radio link: recorded late, stamped right."""
    messages = log.of(STATES)
    stamps = [m.log_time for m in messages]
    for k, message in enumerate(messages):
        arrival = stamps[min(k - k % 3 + 2, len(messages) - 1)]
        message.log_time = arrival + (k % 3) * 1_000_000 + int(rng.integers(1_000_000))
    log.messages.sort(key=lambda m: m.log_time)


def clock_set_forward(log: Log, rng: Rng) -> None:
    """The recorder's clock is set 1 to 3 s forward in mid-recording, as by NTP; the sensors' clock goes on."""
    _log_clock_jumps(log, rng, rng.uniform(1, 3))


def clock_set_back(log: Log, rng: Rng) -> None:
    """The recorder's clock is set 0.6 to 1.2 s back in mid-recording."""
    _log_clock_jumps(log, rng, -rng.uniform(0.6, 1.2))


def _log_clock_jumps(log: Log, rng: Rng, by_s: float) -> None:
    edge = log.start_ns + int(rng.uniform(0.4, 0.7) * log.span_s * SECOND_NS)
    for message in log.messages:
        if message.log_time >= edge:
            message.log_time += int(by_s * SECOND_NS)


def sensor_clock_jumps(log: Log, rng: Rng) -> None:
    """The clock of the joints' driver jumps by 0.6 to 2 s in mid-recording: stamps part from the time of arrival."""
    by_ns = int(rng.choice([-1, 1]) * rng.uniform(0.6, 2) * SECOND_NS)
    messages = log.of(STATES)
    for message in messages[int(rng.uniform(0.4, 0.7) * len(messages)):]:
        log.stamp(message, message.publish_time + by_ns)


def clock_offset(log: Log, rng: Rng) -> None:
    """The clock of the joints' driver lies 0.25 to 0.6 s off all others."""
    by_ns = int(rng.choice([-1, 1]) * rng.uniform(0.25, 0.6) * SECOND_NS)
    for message in log.of(STATES):
        log.stamp(message, message.publish_time + by_ns)


def clock_drift(log: Log, rng: Rng) -> None:
    """The clock of the joints' driver loses or gains 0.08 to 0.15 s over the recording."""
    by_s = rng.choice([-1, 1]) * rng.uniform(0.08, 0.15)
    messages = log.of(STATES)
    start, span = messages[0].publish_time, messages[-1].publish_time - messages[0].publish_time
    for message in messages:
        share = (message.publish_time - start) / span
        log.stamp(message, message.publish_time + int(by_s * share * SECOND_NS))
