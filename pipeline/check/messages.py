"""Messages that are missing or there twice, topics that are missing or fall silent, files that do not hold together."""

from collections.abc import Iterator

import numpy as np

from pipeline.check.own_time import told_missing
from pipeline.check.signals import Ns, Signals, Topic
from schemas.contract import CameraRule, Contract, TopicRule
from schemas.finding import Finding

COMMON_STEP = 0.8
"""Share of equal steps from which on a running number is believed to run evenly."""


def sequence(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Running numbers: one that is left out is a lost message, one that returns is there twice."""
    for topic in signals.topics.values():
        if topic.sequence is None or topic.tabled or not topic.steady or not topic.sequence.any():
            continue
        steps = np.diff(topic.sequence)
        common, share = _common(steps)
        twice = np.flatnonzero(steps == 0)
        if twice.size:
            yield _repeated(signals, topic, int(twice[0]), int(twice.size))
        elif (back := np.flatnonzero(steps < 0)).size:
            k = int(back[0]) + 1
            yield Finding(check="sequence", what=f"message {k} has number {topic.sequence[k]}, the one before "
                          f"{topic.sequence[k - 1]}", where=topic.name, at_s=signals.at_s(int(topic.log_ns[k])),
                          frame=k, value=float(back.size), limit=0.0,
                          mend="record through one queue that keeps the order")
        lost = steps > common
        missing = int((steps[lost] // common - 1).sum()) if common > 0 and share >= COMMON_STEP else 0
        if topic.name in signals.cameras and missing <= told_missing(signals, topic.name):
            continue  # `frames` weighs what the recorder counted itself
        if missing > contract.thresholds.missing_share * len(topic):
            k = int(np.flatnonzero(lost)[0]) + 1
            yield Finding(check="sequence", what=f"{missing} of {len(topic) + missing} messages are missing by their "
                          "sequence numbers", where=topic.name, at_s=signals.at_s(int(topic.log_ns[k])), frame=k,
                          value=float(missing), limit=contract.thresholds.missing_share * len(topic),
                          mend="record again with a longer queue; a hole in the commands cannot be filled in")


def _common(steps: Ns) -> tuple[int, float]:
    """The most frequent step of a running number, and its share."""
    values, counts = np.unique(steps, return_counts=True)
    return int(values[counts.argmax()]), float(counts.max() / counts.sum())


def _repeated(signals: Signals, topic: Topic, k: int, count: int) -> Finding:
    return Finding(check="sequence", what=f"{count} messages are there twice, the first is number {topic.sequence[k]}"
                   if topic.sequence is not None else f"{count} messages are there twice", where=topic.name,
                   at_s=signals.at_s(int(topic.log_ns[k + 1])), frame=k + 1, value=float(count), limit=0.0,
                   mend="leave the second ones out: two recorders or a retried upload wrote into one file")


def coverage(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Required topics and cameras: there, of the right type, decodable, speaking from the beginning to the end."""
    cameras = {name: rule for name, rule in contract.cameras.items() if name not in contract.topics}
    for name, rule in (*contract.topics.items(), *cameras.items()):
        topic = signals.topics.get(name)
        stamps = _stamps(signals, name)
        if not len(stamps):
            if rule.required:
                what = f"topic {name}, required by contract {contract.name!r}, is missing"
                yield Finding(check="coverage", what=what, where=signals.name,
                              mend="start its sensor or driver and record again; or, in the contract, required: false")
            continue
        if isinstance(rule, TopicRule) and topic is not None and rule.type and topic.type \
                and _plain(topic.type) != _plain(rule.type):
            yield Finding(check="coverage", what=f"type is {topic.type}, the contract asks for {rule.type}", where=name,
                          mend="record the topic with the driver that the contract was made for")
        if isinstance(rule, CameraRule) or rule.rate_hz is not None:
            yield from _edges(signals, name, stamps, contract)
    required = {*contract.topics, *contract.cameras}
    for topic in signals.topics.values():
        if topic.undecoded:
            yield Finding(check="coverage", severity="error" if topic.name in required else "warning",
                          what=f"{topic.undecoded} of {len(topic)} messages cannot be decoded", where=topic.name,
                          value=float(topic.undecoded), limit=0.0,
                          mend="record with the message definition that the driver really uses")


def _stamps(signals: Signals, name: str) -> Ns:
    """Stamps of a topic, or of a dataset's camera; empty where there is neither."""
    topic, camera = signals.topics.get(name), signals.cameras.get(name)
    if topic is not None:
        return topic.log_ns
    return camera.stamps_ns if camera is not None else np.empty(0, np.int64)


def _edges(signals: Signals, name: str, stamps: Ns, contract: Contract) -> Iterator[Finding]:
    """A topic that begins after the recording, or ends before it."""
    span, limit = signals.stop_ns - signals.start_ns, contract.thresholds.cover_share
    first, last = int(stamps.min()), int(stamps.max())
    for lost, edge, what in ((first - signals.start_ns, first, "begins {:.3g} s late"),
                             (signals.stop_ns - last, last, "ends {:.3g} s early")):
        if span > 0 and lost / span > limit:
            yield Finding(check="coverage", what=what.format(lost / 1e9), where=name, at_s=signals.at_s(edge),
                          value=lost / span, limit=limit,
                          mend="wait for every sensor before recording; drop the episode")


def _plain(kind: str) -> str:
    """sensor_msgs/msg/JointState and sensor_msgs/JointState are one type."""
    return kind.replace("/msg/", "/")


def truncated(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """A recording that was cut off: its file ends early, says so, or holds fewer ticks than it promises."""
    mend = "record the episode again; what is whole can be kept for looking at: hardcase recover"
    if fact := signals.faults.get("truncated"):
        yield Finding(check="truncated", what=fact, where=signals.name, mend=mend)
    elif not any(len(t) for t in signals.topics.values()):
        yield Finding(check="truncated", what="it holds no message", where=signals.name, mend=mend)
    elif signals.metadata.get("episode", {}).get("truncated") == "true":
        yield Finding(check="truncated", what="the recording was cut off, and recovered as far as it was whole",
                      where=signals.name, mend=mend)


def summary(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """A summary that does not count what the file holds: readers that trust it lose data without a word."""
    if fact := signals.faults.get("summary"):
        yield Finding(check="summary", what=fact, where=signals.name,
                      mend="write the summary anew: mcap recover IN -o OUT")
