"""A first ingest map for a log: what its topics look like, written down with what was seen of them."""

import re
from collections.abc import Sequence
from pathlib import Path

import yaml

from pipeline.errors import RecordingError
from pipeline.logs.child import Children
from pipeline.logs.roles import Taken, kind, marks, picture, role, slug, take, words
from pipeline.logs.survey import Survey, TopicSeen, survey

SIDE_BY_SIDE = 8
"""Topics that are suggested as one state where there is no arm."""
TOGETHER_S = 0.2
"""Header stamps and log times this close may stand beside each other [s]."""
SLOWEST_HZ = 2.0
"""A slower topic does not decide how many frames a second are suggested [Hz]."""
FULL_TURN = 6.5
"""Joint positions beyond one turn look like degrees [rad]."""
_CAMERA_WORDS = frozenset({"camera", "cam", "color", "compressed", "image", "images", "raw", "rect", "rgb"})
_FEATURE_WORDS = frozenset({"action", "command", "commands", "observation", "observations"})
_SIMPLE = re.compile(r"/?[A-Za-z_][\w/.]*", re.ASCII)
_LISTED = 60


def suggest(log: Path, *, children: Children | None = None) -> str:
    """A first map for a log, as YAML with comments; loads as an IngestMap.

    Args:
        log: an MCAP file; it is read in a limited child.
        children: a pool to use; one child for this call without.

    Raises:
        RecordingError: damaged, hostile, cut off, not MCAP, or without a number that could become a feature.
    """
    if children is None:
        with Children() as own:
            return suggest(log, children=own)
    return first_map(log.name, Survey.model_validate(children.call(survey, str(log), where=log)))


def first_map(name: str, seen: Survey) -> str:
    """The map for what was seen of a log called `name`.

    Raises:
        RecordingError: nothing in it could become a feature.
    """
    guess = _Guess(seen.topics)
    if not guess.state and not guess.action:
        topics = ", ".join(_plain(t.topic) for t in seen.topics[:_LISTED]) or "no topic at all"
        raise RecordingError("no topic has a number that could become a feature", where=name,
                             mend=f"record what the robot senses and is told; the log holds: {topics}")
    stem = slug(name.removesuffix(".mcap"))
    lines = [f"# A first map for {_plain(name)}, guessed from names, types and shapes: read it before you use it.",
             f"# Then: hardcase ingest {_plain(name)} --map THIS_FILE", "#", *_table(seen), "",
             f"name: {stem}", "robot: robot  # say which", "task: unknown  # say what the robot was asked to do",
             *guess.rates(), *guess.clocks(), "", "features:", *guess.features(), *guess.cameras(), *guess.episodes(),
             *_CONSENT]
    return "\n".join(lines) + "\n"


_CONSENT = ("# Nothing is learnt from a log until whoever drove has consented: hardcase consent add",
            "# consent: form-12  # id of the record", "# operator: op-7  # the pseudonym in it")


class _Guess:
    """What each topic is taken for."""

    def __init__(self, topics: Sequence[TopicSeen]) -> None:
        alive = [topic for topic in topics if topic.messages]
        by_role: dict[str, list[Taken]] = {"state": [], "command": [], "sensor": [], "plumbing": []}
        for topic in sorted(alive, key=lambda topic: -topic.messages):
            taken = take(topic)
            if taken is not None:
                by_role[role(topic, taken)].append(taken)
        self.pictures = [(topic, field) for topic in alive if (field := picture(topic))]
        self.topics = alive
        joints = sorted(by_role["state"], key=lambda taken: not taken.joints and not taken.names)
        self.arm = bool(joints)
        sensors = by_role["sensor"] or ([] if by_role["command"] else by_role["plumbing"])
        self.only_plumbing = not joints and not by_role["sensor"] and bool(sensors)
        self.state = joints[:1] or sensors[:SIDE_BY_SIDE]
        self.action = sorted(by_role["command"], key=lambda taken: "joint" not in words(taken.topic.topic))[:1]
        used = {id(taken.topic) for taken in (*self.state, *self.action)}
        self.others = [taken for name in ("state", "command", "sensor") for taken in by_role[name]
                       if id(taken.topic) not in used]
        self.chosen = [taken.topic for taken in (*self.state, *self.action)] + [topic for topic, _ in self.pictures]
        self.clock = self._clock()

    def rates(self) -> list[str]:
        """The frames a second: as many as the slowest topic has that is not merely an event now and then."""
        rates = {topic.topic: topic.rate_hz for topic in self.chosen if topic.rate_hz > 0}
        steady = {topic: hz for topic, hz in rates.items() if hz >= SLOWEST_HZ} or rates
        if not steady:
            return ["fps: 10  # a guess: no topic has two messages"]
        slowest = min(steady, key=lambda topic: steady[topic])
        hz = min(max(round(steady[slowest]), 1), 1000)
        return [f"fps: {hz}  # the rate of {_plain(slowest)}, the slowest that is used"]

    def _clock(self) -> str:
        stamps = [topic.stamps for topic in self.chosen]
        own = [seen for seen in stamps if seen is not None and seen.sane]
        bare = sum(seen is None for seen in stamps)
        if not own or len(own) + bare < len(stamps):
            return "log"
        apart = max(seen.behind_s for seen in own) - min(seen.behind_s for seen in own)
        near = max(abs(seen.behind_s) for seen in own)
        return "header" if apart < 1.0 and (not bare or near < TOGETHER_S) else "log"

    def clocks(self) -> list[str]:
        """The clock, and why."""
        if self.clock == "header":
            own = [topic.stamps.behind_s for topic in self.chosen if topic.stamps]
            return [f"clock: header  # the stamps are set and rise; log time is {_seconds(max(own))} behind at most"]
        odd = [topic.topic for topic in self.chosen if topic.stamps and not topic.stamps.sane]
        why = f"the stamps of {_plain(odd[0])} are not set or go back" if odd else "the messages have no common stamps"
        return [f"clock: log  # {why}"]

    def features(self) -> list[str]:
        """State, action, and as comments what else could be a feature."""
        lines: list[str] = []
        if not self.arm:
            lines.append("  # No topic looks like an arm's joints; these sensors stand side by side instead.")
        if self.only_plumbing:
            lines.append("  # Only topics of the middleware hold numbers; this is hardly what you want.")
        if self.state:
            lines += self._feature("observation.state", self.state)
        if self.action:
            lines += self._feature("action", self.action)
        else:
            lines.append("  # No topic looks like a command. If one is, call it `action`: what the robot was told.")
        names = ["observation.state", "action"]
        for taken in self.others[:_LISTED]:
            kind_of = "action" if role(taken.topic, taken) == "command" else "observation"
            name = f"{kind_of}.{slug(taken.topic.topic, drop=_FEATURE_WORDS)}"
            name = name if name not in names else f"{name}_{len(names)}"
            names.append(name)
            lines += [f"  # {line[2:]}" for line in self._feature(name, [taken])]
        return lines

    def _feature(self, name: str, many: Sequence[Taken]) -> list[str]:
        lines = [f"  {name}:"]
        for taken in many:
            first, *rest = self._source(taken)
            lines += [f"    # {line}" for line in _said(taken)]
            lines += [f"    - {first}", *(f"      {line}" for line in rest)]
        return lines

    def _source(self, taken: Taken) -> list[str]:
        topic = taken.topic
        lines = [f"topic: {_quoted(topic.topic)}", f"fields: [{', '.join(map(_quoted, taken.fields))}]"]
        if taken.joints:
            lines.append(f"joints: [{', '.join(map(_quoted, taken.joints))}]")
            if taken.joints_field != "name":
                lines.append(f"joints_field: {_quoted(taken.joints_field)}")
        if taken.names:
            lines.append(f"names: [{', '.join(map(_quoted, taken.names))}]")
        return lines + self._timing(topic)

    def _timing(self, topic: TopicSeen) -> list[str]:
        lines = [] if self.clock == "log" or topic.stamps else ["clock: log  # it has no stamp of its own"]
        if 0 < topic.rate_hz < 15 or topic.jitter_s > 0.05:
            apart = topic.jitter_s + (1 / topic.rate_hz if topic.rate_hz else 0.0)
            lines.append(f"max_skew_s: {max(round(1.5 * apart, 2), 0.1):g}  # messages come {_seconds(apart)} apart")
        return lines

    def cameras(self) -> list[str]:
        """The cameras."""
        if not self.pictures:
            return ["# No topic holds JPEG, PNG or raw images: no cameras."]
        lines, names = ["cameras:"], list[str]()
        for topic, field in self.pictures:
            name = slug(topic.topic, names, _CAMERA_WORDS)
            names.append(name)
            size = topic.bytes / topic.messages / 1e3
            lines += [f"  {name}:", f"    # {_plain(kind(topic))}, {topic.blobs[field] or 'raw'}: {_rate(topic)}, "
                      f"{size:.0f} kB a message", f"    topic: {_quoted(topic.topic)}",
                      *([f"    field: {_quoted(field)}"] if field != "data" else []),
                      *(f"    {line}" for line in self._timing(topic))]
        return lines

    def episodes(self) -> list[str]:
        """Where episodes begin and end."""
        for topic in self.topics:
            if found := marks(topic):
                field, starts, stops = found
                lines = ["episodes:", f"  # {_plain(topic.topic)} says so {topic.messages} times", "  by: marker",
                         f"  topic: {_quoted(topic.topic)}", f"  field: {_quoted(field)}",
                         f"  start: {_values(starts)}"]
                lines += [f"  stop: {_values(stops)}"] if stops else []
                return lines + (["  clock: log"] if self.clock == "header" and not topic.stamps else [])
        pauses = next((taken.topic for taken in self.state if taken.topic.pauses), None)
        if pauses is None:
            return ["# No topic marks episodes and nothing pauses: the whole file is one.", "episodes: {by: file}"]
        longest = ", ".join(_seconds(pause) for pause in pauses.pauses[:4])
        return ["episodes:", f"  # The longest silences of {_plain(pauses.topic)}: {longest}",
                "  by: gap", f"  longer_than_s: {max(round(min(pauses.pauses) / 2, 1), 0.5):g}",
                f"  topic: {_quoted(pauses.topic)}"]


def _said(taken: Taken) -> list[str]:
    topic = taken.topic
    lines = [f"{_plain(topic.type) or 'no type'}: {_rate(topic)}, {_messages(topic)}, "
             + _plain(", ".join(f"{field} {_range(topic, field)}" for field in taken.fields[:3]))]
    seen = topic.numbers[taken.fields[0].split("[")[0]]
    if (taken.joints or taken.names) and not seen.integral and max(abs(seen.low or 0), abs(seen.high or 0)) > FULL_TURN:
        lines.append("More than one turn: if these are degrees, add `unit: deg_to_rad`.")
    if taken.joints and topic.named.get(taken.joints_field, 1) > 1:
        lines.append(f"{topic.named[taken.joints_field]} sets of names share the topic; this is the commonest.")
    if taken.left:
        lines.append(f"Also there: {_plain(', '.join(taken.left[:8]))}{', ...' if len(taken.left) > 8 else ''}")
    return lines


def _range(topic: TopicSeen, field: str) -> str:
    seen = topic.numbers[field.split("[")[0]]
    return "is never finite" if seen.low is None else f"from {seen.low:.4g} to {seen.high:.4g}"


def _table(seen: Survey) -> list[str]:
    lines = ["# topic, type, encoding: messages, rate, jitter"]
    for topic in seen.topics[:_LISTED]:
        notes = [_messages(topic), *([_rate(topic)] if topic.messages > 1 else [])]
        notes += [f"{topic.latched} latched at time 0"] if topic.latched else []
        notes += [f"cannot be decoded: {_plain(topic.reason)}"] if topic.reason else []
        notes += [f"{topic.bad} not decoded, the first: {_plain(topic.bad_reason)}"] if topic.bad else []
        lines.append(f"#   {_plain(topic.topic)}, {_plain(topic.type) or 'no type'}, {_plain(topic.encoding)}: "
                     + ", ".join(notes))
    lines += [f"#   and {len(seen.topics) - _LISTED} more"] if len(seen.topics) > _LISTED else []
    return lines + [f"# Odd: {_plain(problem)}" for problem in seen.problems[:_LISTED]]


def _rate(topic: TopicSeen) -> str:
    return f"{topic.rate_hz:.4g} Hz (jitter {_seconds(topic.jitter_s)})" if topic.rate_hz else "no rate"


def _messages(topic: TopicSeen) -> str:
    return f"{topic.messages} message{'s' * (topic.messages != 1)}"


def _seconds(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms" if abs(seconds) < 1 else f"{seconds:.3g} s"


def _values(values: Sequence[str | int]) -> str:
    return f"[{', '.join(_quoted(v) if isinstance(v, str) else str(v) for v in values)}]"


def _quoted(text: str) -> str:
    """Text as YAML reads it back, on one line; without quotes where it needs none."""
    if _SIMPLE.fullmatch(text) and yaml.safe_load(text) == text:
        return text
    return yaml.safe_dump(text, default_style='"', width=1 << 30).strip()


def _plain(text: str) -> str:
    """Somebody else's text, for a comment: one line, nothing that YAML would not take."""
    return "".join(c if c.isprintable() and c.isascii() else "?" for c in text[:160])
