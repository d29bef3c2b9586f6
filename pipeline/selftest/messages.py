"""Faults of messages and topics: missing, there twice, out of order, unreadable, silent."""

from collections.abc import Callable

import numpy as np

from pipeline.selftest.log import Log, copy_of

type Rng = np.random.Generator

STATES, COMMANDS = "/joint_states", "/joint_commands"


def without(topic: str) -> Callable[[Log, Rng], None]:
    """A topic was not recorded at all."""
    def plant(log: Log, rng: Rng) -> None:
        log.drop(lambda m: log.topic(m) == topic)
        log.channels = {n: c for n, c in log.channels.items() if c.topic != topic}
    return plant


def topic_dies(log: Log, rng: Rng) -> None:
    """The joint commands end when 60 to 80 % of the attempt are over."""
    end = rng.uniform(0.6, 0.8) * log.span_s
    log.drop(lambda m: log.topic(m) == COMMANDS and log.at_s(m) > end)


def lost_messages(log: Log, rng: Rng) -> None:
    """Three single messages of the joints are missing, here and there: a full queue."""
    inner = log.of(STATES)[2:-2]
    lost = {id(inner[int(k)]) for k in rng.choice(len(inner) // 2, 3, replace=False) * 2}
    log.drop(lambda m: id(m) in lost)


def doubled_messages(log: Log, rng: Rng) -> None:
    """Four messages of the joints are there twice, 1 ms apart: a retry after a lost acknowledgement."""
    twice = {id(m) for m in rng.choice(np.array(log.of(STATES)[2:-2], object), 4, replace=False)}
    log.messages = [n for m in log.messages
                    for n in ((m, copy_of(m, log_time=m.log_time + 1_000_000)) if id(m) in twice else (m,))]


def exchanged_messages(log: Log, rng: Rng) -> None:
    """Two neighbouring messages of the joints were recorded in the wrong order."""
    messages = log.of(STATES)
    k = int(rng.integers(3, len(messages) - 3))
    one, other = messages[k], messages[k + 1]
    for name in ("data", "sequence", "publish_time"):
        first = getattr(one, name)
        setattr(one, name, getattr(other, name))
        setattr(other, name, first)


def torn_messages(log: Log, rng: Rng) -> None:
    """Three joint messages are shorter than their definition says: the driver was built against another one."""
    messages = log.of(STATES)
    for k in rng.choice(len(messages), 3, replace=False):
        messages[int(k)].data = messages[int(k)].data[:-24]


def fewer_than_ticks(log: Log, rng: Rng) -> None:
    """Three ticks are missing, and what is left was numbered anew: the recording promises more than it holds."""
    messages = log.of(STATES)
    first = int(rng.integers(3, len(messages) - 8))
    numbers = [m.sequence for m in messages[first:first + 3]]
    log.drop(lambda m: m.sequence in numbers and log.topic(m) != "/robot_description" and bool(m.sequence))
    for message in log.messages:
        if message.sequence > numbers[-1]:
            message.sequence -= 3
            message.log_time -= 150_000_000
            log.stamp(message, message.publish_time - 150_000_000)
