"""ROS 2 message definitions (`ros2msg`): the text that a log carries, parsed into types.

Source: docs.ros.org, "Interfaces"; the MCAP specification's registry, "ros2msg".
"""

import re
from dataclasses import dataclass
from typing import Literal

from pipeline.errors import RecordingError

PRIMITIVES = {
    "bool": "u1", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}
"""Type -> numpy's name without byte order. char is uint8 in ROS 2."""
TEXTS = ("string", "wstring")
TIMES = ("builtin_interfaces/Time", "builtin_interfaces/Duration")

type Count = int | Literal["one", "many"]
"""How often a member is there: once, n times, or as often as the message says."""

_SEPARATOR = re.compile(r"^={20,}[ \t]*$", re.MULTILINE)
_TITLE = re.compile(r"\A\s*(MSG|IDL):[ \t]*(\S+)[ \t]*$", re.MULTILINE)
_MEMBER = re.compile(r"([A-Za-z][\w/]*)(?:<=\d+)?(?:\[(<=)?(\d*)\])?\s+([A-Za-z]\w*)\s*(.*)")
MEND = "record with the type's own package sourced, or leave the topic out of the map"
"""What a person can do about a schema that cannot be used."""


@dataclass(frozen=True, slots=True)
class Member:
    """One field of a message type."""

    name: str
    kind: str
    """A primitive of PRIMITIVES, a text of TEXTS, or the name of a type as package/Type."""
    count: Count


type Types = dict[str, tuple[Member, ...]]
"""Name of a type as package/Type -> its fields in order."""


def short(name: str) -> str:
    """package/Type: the name without the `msg`, `srv` or `action` that some writers put between."""
    parts = re.split(r"::|/", name.strip())
    return "/".join([parts[0], parts[-1]] if len(parts) > 1 else parts)


def parse(name: str, text: str, where: object) -> Types:
    """All types that a `ros2msg` schema defines, the one called `name` first.

    Raises:
        RecordingError: a service definition, an unknown type, or a line that is no field.
    """
    types: Types = {}
    for k, (title, body) in enumerate(_sections(name, text)):
        if k == 0 or title not in types:
            types[title] = tuple(_members(title, body, where))
    known = {"std_msgs/Header": (Member("stamp", TIMES[0], "one"), Member("frame_id", "string", "one"))}
    for title, members in known.items():
        types.setdefault(title, members)
    return {title: tuple(_resolved(title, member, types, where) for member in members)
            for title, members in types.items() if title not in TIMES}


def _sections(name: str, text: str) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for part in _SEPARATOR.split(text.replace("\r\n", "\n")):
        title = _TITLE.match(part)
        if title:
            found.append((short(title[2]), part[title.end():]))
        elif not found:
            found.append((short(name), part))
    first = next((k for k, (title, _) in enumerate(found) if title == short(name)), 0)
    return [found[first], *found[:first], *found[first + 1:]] if found else [(short(name), "")]


def _members(title: str, body: str, where: object) -> list[Member]:
    members: list[Member] = []
    for line in body.split("\n"):
        line = line.strip()
        if line == "---":
            raise RecordingError(f"{title} is a service definition, its events are not decoded", where=where,
                                 mend="leave the topic out of the map; it stays in the raw file")
        if not line or line.startswith("#"):
            continue
        match = _MEMBER.fullmatch(line)
        if not match:
            raise RecordingError(f"{title}: {line[:80]!r} is no field", where=where, mend=MEND)
        kind, upto, count, field, rest = match.groups()
        if rest.startswith("="):  # a constant; anything else is a default value, which the messages do not need
            continue
        sequence: Count = "one" if count is None else "many" if upto or not count else int(count)
        members.append(Member(field, kind, sequence))
    return members


def _resolved(title: str, member: Member, types: Types, where: object) -> Member:
    """The member with its type's full name: a bare name belongs to the same package, or to the only one that has it."""
    kind = member.kind
    if kind in PRIMITIVES or kind in TEXTS:
        return member
    if kind in ("time", "duration"):
        return Member(member.name, TIMES[kind == "duration"], member.count)
    if kind == "Header":
        return Member(member.name, "std_msgs/Header", member.count)
    full = short(kind) if "/" in kind else f"{title.split('/')[0]}/{kind}"
    if full not in types and full not in TIMES:
        alike = [other for other in (*types, *TIMES) if other.split("/")[-1] == kind]
        if len(alike) != 1:
            raise RecordingError(f"{title}.{member.name} is of type {kind}, which the schema does not define",
                                 where=where, mend=MEND)
        full = alike[0]
    return Member(member.name, full, member.count)
