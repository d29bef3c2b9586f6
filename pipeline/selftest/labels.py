"""Faults of what a recording says of itself: outcome, consent, robot, task, rate; and one that is there twice."""

from collections.abc import Callable

import numpy as np

from pipeline.files import short_id
from pipeline.selftest.clocks import SECOND_NS
from pipeline.selftest.log import Log
from pipeline.selftest.values import COMMANDED, MEASURED
from schemas.consent import NO_CONSENT
from schemas.episode import Episode, Outcome

type Rng = np.random.Generator

NUMBERS = (MEASURED, COMMANDED, ("/ee/measured", "data"), ("/ee/commanded", "data"), ("/command/ee", "data"),
           ("/observation/environment", "data"))


def called_success(log: Log, rng: Rng) -> None:
    """A failed attempt is recorded as a success."""
    _relabel(log, Outcome(label="success", judged_by="operator"))


def called_failure(log: Log, rng: Rng) -> None:
    """A success is recorded as a failure."""
    _relabel(log, Outcome(label="failure", judged_by="operator"))


def _relabel(log: Log, outcome: Outcome) -> None:
    log.tell(log.episode.model_copy(update={"outcome": outcome}))


def no_consent(log: Log, rng: Rng) -> None:
    """A person drives, and no consent record is named."""
    log.tell(_driven(log.episode, NO_CONSENT), operator="ada")


def feigned_simulation(log: Log, rng: Rng) -> None:
    """A person drives, and the recording says that nobody was recorded."""
    log.tell(_driven(log.episode, "simulated"), operator="ada")


def _driven(episode: Episode, consent: str) -> Episode:
    segments = tuple(s.model_copy(update={"kind": "demonstration", "actor": "ada"}) for s in episode.segments)
    return episode.model_copy(update={"origin": "teleop", "policy": None, "segments": segments, "consent": consent})


def says(**strings: str) -> Callable[[Log, Rng], None]:
    """The recording names another robot, task or rate than the policy will be judged with."""
    def plant(log: Log, rng: Rng) -> None:
        episode = log.episode
        named = {k: v for k, v in strings.items() if k in ("robot", "task")}
        changes = {"scene": episode.scene.model_copy(update=named)}
        log.tell(episode.model_copy(update=changes), **strings)
    return plant


def at_other_rate(log: Log, rng: Rng) -> None:
    """The whole recording runs at 25 Hz, and says so; the policy will be asked at 20 Hz."""
    start = log.start_ns
    for message in log.messages:
        message.log_time = start + (message.log_time - start) * 4 // 5
        log.stamp(message, start + (message.publish_time - start) * 4 // 5)
    log.tell(log.episode.model_copy(update={"control_hz": 25.0}), control_hz="25.0")


def twice(log: Log, rng: Rng) -> None:
    """The same attempt under another id: an upload that was tried again."""
    log.tell(log.episode.model_copy(update={"id": short_id("again", rng.integers(1 << 30)), "parent": None}))


def nearly_twice(log: Log, rng: Rng) -> None:
    """The same attempt through a text file with four digits, under another id."""
    for part in NUMBERS:
        log.put(*part, log.numbers(*part).round(4))
    twice(log, rng)


def twice_without_its_start(log: Log, rng: Rng) -> None:
    """The same attempt without its first 0.5 s, under another id."""
    edge = log.start_ns + SECOND_NS // 2
    urdf = next((m for m in log.messages if log.topic(m) == "/robot_description"), None)
    ticks = sum(m.log_time < edge for m in log.of("/joint_states"))
    log.drop(lambda m: m.log_time < edge and m is not urdf)
    if urdf is not None:
        urdf.log_time = urdf.publish_time = min(m.log_time for m in log.messages if m is not urdf)
    for message in log.messages:
        message.sequence = max(0, message.sequence - ticks)
    episode = log.episode
    first, *rest = episode.segments
    shorter = [first.model_copy(update={"stop": first.stop - ticks}),
               *(s.model_copy(update={"start": s.start - ticks, "stop": s.stop - ticks}) for s in rest)]
    frames = episode.frames - ticks
    log.tell(episode.model_copy(update={"frames": frames, "segments": tuple(shorter)}), frames=str(frames))
    twice(log, rng)
