"""Session: what a person, a robot and a policy share while they work together."""

from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pipeline.protocols import Observation, Policy, Teleoperator
from pipeline.recording.live import LiveRecorder
from pipeline.recording.ring import RingRecorder
from pipeline.robots.judging import Alarm
from pipeline.robots.limits import Limits
from pipeline.robots.mapping import Driver
from pipeline.shadow.live import LiveShadow
from schemas.scene import SceneSpec

type SceneOf = Callable[[int, Observation], SceneSpec]
"""(attempt from 0, what the robot perceives before it) -> its start: made up in simulation, perceived elsewhere."""
type Film = Callable[[LiveRecorder | RingRecorder], AbstractContextManager[Callable[[int, int], None]]]
"""Films into a recording while it is open; what it gives is called with (tick, time [ns]) when the robot perceived."""
type Who = Literal["operator", "policy", "reset"]


@contextmanager
def no_film(recorder: LiveRecorder | RingRecorder) -> Generator[Callable[[int, int], None]]:
    """No camera beside the robot's own."""
    yield lambda tick, stamp_ns: None


@dataclass(frozen=True, slots=True)
class Status:
    """What a person is shown at every tick."""

    attempt: int
    """From 1."""
    seconds: float
    """Length of the attempt so far; of the pause, between attempts [s]."""
    who: Who
    """Who commands; 'reset' between attempts, when nothing is recorded."""
    observation: Observation
    note: str
    """What was wrong with the last command, or what the policy fails at; empty where nothing is."""


@dataclass(frozen=True, slots=True)
class Session:
    """What all attempts of a session share."""

    operator: str
    """The person's pseudonym."""
    consent: str
    """Id of the person's consent, or 'none'."""
    folder: Path
    """Where recordings are written."""
    software: Mapping[str, str]
    """Strings for each file's metadata."""
    config: Mapping[str, object]
    """What was in force, attached as config.json."""
    number: int
    """Sets this session apart from others with the same starts."""
    episodes: int = 1
    """How many attempts."""
    max_s: float = 120.0
    """Longest attempt [s]."""
    by_key: bool = False
    """Only the person ends an attempt, not the robot's belief in success."""
    stop_on_trigger: bool = False
    """A trigger that fires while the policy drives ends the attempt as a failure; else the person is only told."""
    ring: bool = False
    """Keep every tick only around triggers and while a person commands, one in ten elsewhere."""
    ask: bool = True
    """Wait for 'next' before each attempt; the robot can be driven meanwhile, unrecorded, to reset it."""
    show: Callable[[Status], None] = field(default=lambda status: None)
    """Called at every tick."""
    stop: Callable[[], bool] = field(default=lambda: False)
    """Whether somebody wants the session to end now: the attempt is cut off and kept."""


@dataclass(frozen=True, slots=True)
class Controls:
    """Who can command the robot, and what may be sent to it."""

    device: Teleoperator
    driver: Driver
    limits: Limits
    policy: Policy | None = None
    policy_name: str = ""
    """Id of the policy, or 'expert'; the actor of the autonomous segments."""
    policy_id: str | None = None
    """Id of the policy in the store; None for the expert."""
    alarm: Alarm | None = None
    """Watches the policy; None where the robot does not perceive what it works on."""
    film: Film = no_film
    """Films an attempt with cameras that are no part of the robot."""
    shadow: LiveShadow | None = None
    """Candidates that are shown what the robot perceives, whoever commands, and cannot act."""
