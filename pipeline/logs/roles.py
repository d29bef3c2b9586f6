"""Guesses from names, types and shapes: which topic of a foreign log is state, command, camera or marker."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from pipeline.logs.ros2_types import short
from pipeline.logs.survey import NumbersSeen, TopicSeen

COMMANDS = frozenset({"action", "actions", "cmd", "cmds", "command", "commands", "desired", "goal", "goals", "leader",
                      "reference", "setpoint", "setpoints", "target", "targets"})
MEASURED = frozenset({"actual", "feedback", "measured", "odom", "proprio", "result", "state", "states", "status"})
PLUMBING = frozenset({"bond", "clock", "diagnostics", "introspection", "parameter", "rosout", "statistics", "tf"})
PACKAGES = frozenset({"action_msgs", "bond", "builtin_interfaces", "diagnostic_msgs", "lifecycle_msgs",
                      "rcl_interfaces", "rosgraph_msgs", "statistics_msgs", "tf2_msgs", "visualization_msgs"})
COMMAND_TYPES = frozenset({"AckermannDrive", "AckermannDriveStamped", "JointJog", "JointTrajectory", "Twist"})
PICTURES = frozenset({"CompressedImage", "Image", "RawImage"})
"""Types that hold one whole image a message."""
MARKERS = frozenset({"demo", "demonstration", "episode", "episodes", "event", "events", "marker", "markers", "record",
                     "recording", "session", "task", "trial"})
STARTS = frozenset({"active", "began", "begin", "record", "recording", "resume", "run", "running", "start", "started"})
STOPS = frozenset({"complete", "completed", "done", "end", "ended", "failure", "finish", "finished", "idle", "inactive",
                   "pause", "paused", "stop", "stopped", "success"})
MAX_VALUES = 64
"""Values that one topic is suggested with; more are hardly a state."""

_BEST = ("position", "positions", "points.positions", "q", "qpos", "joint_positions", "data", "values", "value")
_NEVER = frozenset({"covariance", "dim", "header", "id", "index", "layout", "seq", "sequence", "stamp", "timestamp"})
_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
_PIECES = re.compile(r"[A-Z]?[a-z]+\d*|[A-Z]+(?![a-z])\d*|\d+", re.ASCII)
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")

type Role = Literal["plumbing", "command", "state", "sensor"]


@dataclass(frozen=True, slots=True)
class Taken:
    """What to take of a topic."""

    topic: TopicSeen
    fields: tuple[str, ...]
    joints: tuple[str, ...] = ()
    joints_field: str = ""
    names: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    """Number fields that are there too, with their shape."""


def words(text: str) -> list[str]:
    """The words of a name, in lower case: of /leftArm/cmd_vel left, arm, cmd, vel."""
    return [word.lower() for word in _WORDS.findall(text)]


def kind(topic: TopicSeen) -> str:
    """The type's own name, without its package."""
    return short(topic.type).split("/")[-1].split(".")[-1]


def role(topic: TopicSeen, taken: Taken) -> Role:
    """What the numbers of a topic are likely to be."""
    said = set(words(topic.topic))
    package = re.split(r"[/:.]", topic.type)[0]
    if said & PLUMBING or package in PACKAGES or topic.type.endswith("_Event"):
        return "plumbing"
    if not said & MEASURED and (said & COMMANDS or kind(topic) in COMMAND_TYPES):
        return "command"
    return "state" if taken.joints or taken.names or {"joint", "joints"} & said else "sensor"


def shape(seen: NumbersSeen) -> str:
    """The shape in words: 1 value, 7 values, 0 to 12 values."""
    low, high = seen.widths[0], seen.widths[-1]
    return f"{low} value{'s' * (low != 1)}" if low == high else f"{low} to {high} values"


def take(topic: TopicSeen) -> Taken | None:
    """Which fields make features of a topic; None where it has no number that could."""
    usable = {path: seen for path, seen in topic.numbers.items()
              if _PATH.fullmatch(path) and path not in topic.times and not _NEVER & set(words(path))
              and seen.widths[-1] > 0} if not topic.blobs else {}
    if named := _by_names(topic, usable):
        return named
    fixed = {path: seen.widths[0] for path, seen in usable.items() if len(seen.widths) == 1}
    chosen, total = list[str](), 0
    for path in [path for path in _BEST if path in fixed][:1] or fixed:
        if total + fixed[path] <= MAX_VALUES:
            chosen.append(path)
            total += fixed[path]
    return Taken(topic, tuple(chosen), left=_left(usable, chosen)) if chosen else None


def _by_names(topic: TopicSeen, usable: dict[str, NumbersSeen]) -> Taken | None:
    """Values that a sequence of texts names, such as a JointState's; of a trajectory, its first point."""
    for field, joints in topic.names.items():
        count = len(joints)
        if not {"joint", "joints", "name", "names"} & set(words(field)) or not _PATH.fullmatch(field):
            continue
        if not count or count > MAX_VALUES or len(set(joints)) < count:
            continue
        several = topic.named[field] > 1
        fits = [path for path, seen in usable.items() if len(path.split(".")) <= len(field.split(".")) + 1
                and (count in seen.widths if several else {w % count for w in seen.widths} == {0})]
        if not fits:
            continue
        best = next((path for path in _BEST if path in fits), fits[0])
        left = _left(usable, (best,))
        if several or usable[best].widths == (count,):
            return Taken(topic, (best,), joints, field, left=left)
        return Taken(topic, (f"{best}[0:{count}]" if count > 1 else f"{best}[0]",), names=joints, left=left)
    return None


def _left(usable: dict[str, NumbersSeen], chosen: Iterable[str]) -> tuple[str, ...]:
    taken = set(chosen)
    return tuple(f"{path} ({shape(seen)})" for path, seen in usable.items() if path not in taken)


def picture(topic: TopicSeen) -> str:
    """The field with a camera's images, empty if there is none."""
    for path, magic in topic.blobs.items():
        if _PATH.fullmatch(path) and (magic in ("jpeg", "png") or (kind(topic) in PICTURES and magic != "video")):
            return path
    return ""


def marks(topic: TopicSeen) -> tuple[str, tuple[str | int, ...], tuple[str | int, ...]] | None:
    """(field, values that begin an episode, values that end it) of a topic that tells of episodes."""
    about = bool(MARKERS & set(words(topic.topic)))
    for field, texts in topic.texts.items():
        starts = tuple(text for text in texts if set(words(text)) & STARTS)
        stops = tuple(text for text in texts if set(words(text)) & STOPS and text not in starts)
        few = len(texts) <= 8 and _PATH.fullmatch(field)
        if few and "." not in field and starts and (stops or about) and topic.messages > topic.latched:
            return field, starts, stops
    for field, seen in topic.numbers.items():
        if about and seen.integral and seen.widths == (1,) and (seen.low, seen.high) == (0, 1):
            return field, (1,), (0,)
    return None


def slug(text: str, among: Sequence[str] = (), drop: frozenset[str] = frozenset()) -> str:
    """A name in small letters, other than those in `among`."""
    plain = [word.lower() for word in _PIECES.findall(text) if word.lower() not in drop] or ["it"]
    name = "_".join(plain)[:56]
    name = name if name[0].isalpha() else f"n{name}"
    return name if name not in among else next(f"{name}_{k}" for k in range(2, 9999) if f"{name}_{k}" not in among)
