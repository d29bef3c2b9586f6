"""Where the fields of a ROS 2 message lie: a type compiled to steps, and a walk over one payload.

Messages whose texts and sequences are as long have every field at the same place: one walk serves them all.

Source: OMG DDSI-RTPS 2.3, 10.2 (encapsulation); CORBA 3.3 part 2, 9.3 (alignment counts from the byte after the
encapsulation; an empty sequence takes no padding; a text's length counts its closing zero byte).
"""

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import RecordingError
from pipeline.logs.ros2_types import MEND, PRIMITIVES, TEXTS, TIMES, Count, Types

START = 4
"""Bytes of the encapsulation header."""
SLACK = 3
"""Bytes that may follow the last field: DDS pads payloads to 4."""
MAX_LEAVES = 4096
"""Fields of one type, nested ones counted: far above any robot's."""
MAX_RUNS = 250_000
"""Separate runs of one message: a particle cloud of 35,000 poses."""
_ENCAPSULATIONS = {0: "CDR", 1: "CDR", 2: "PL_CDR", 3: "PL_CDR", 6: "CDR2", 7: "CDR2", 8: "D_CDR2", 9: "D_CDR2",
                   10: "PL_CDR2", 11: "PL_CDR2"}

type Kind = Literal["number", "time", "text", "wide", "blob", "skip"]


@dataclass(frozen=True, slots=True)
class Leaf:
    """A field that holds values, not other fields."""

    path: str
    kind: Kind
    dtype: str
    """numpy's name of one number without byte order."""
    many: bool
    """In a sequence or array, or below one."""

    size: int
    """Bytes of one value."""


@dataclass(frozen=True, slots=True)
class Step:
    """One member of a type: a leaf by its number, or the steps of another type; `count` times."""

    leaf: int
    """-1 where the member is of another message type."""
    inner: "tuple[Step, ...]"
    count: Count
    least: int
    """Bytes that one element takes at least."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A message type, ready to be walked."""

    leaves: tuple[Leaf, ...]
    steps: tuple[Step, ...]
    times: set[str]
    """Paths of times."""


def compile_type(name: str, types: Types, where: object) -> Plan:
    """Compile a type and all that it holds.

    Raises:
        RecordingError: a type holds itself, an array of nothing, or more than MAX_LEAVES fields.
    """
    leaves: list[Leaf] = []

    def step(path: str, kind: str, count: Count, many: bool, above: tuple[str, ...]) -> Step:
        many = many or count != "one"
        if count == 0:
            raise RecordingError(f"{path} is an array of no elements", where=where, mend=MEND)
        if kind not in PRIMITIVES and kind not in TEXTS and kind not in TIMES:
            inner = inside(kind, f"{path}.", many, above)
            return Step(-1, inner, count, sum(_least(s) for s in inner))
        if len(leaves) >= MAX_LEAVES:
            raise RecordingError(f"{name} has more than {MAX_LEAVES} fields", where=where, mend=MEND)
        dtype = PRIMITIVES.get(kind, "u1")
        what: Kind = ("time" if kind in TIMES else "text" if kind == "string" else "wide" if kind == "wstring"
                      else "blob" if count == "many" and kind in ("uint8", "byte", "char") else "number")
        size = 8 if what == "time" else int(dtype[1])
        leaves.append(Leaf(path, what, "?" if kind == "bool" else dtype, many, size))
        return Step(len(leaves) - 1, (), count, 4 if what in ("text", "wide") else size)

    def inside(kind: str, prefix: str, many: bool, above: tuple[str, ...]) -> tuple[Step, ...]:
        if kind in above:
            raise RecordingError(f"{kind} holds itself", where=where, mend=MEND)
        if not types[kind]:  # ROS 2 gives an empty type one byte, since IDL wants a member
            leaves.append(Leaf(prefix, "skip", "u1", many, 1))
            return (Step(len(leaves) - 1, (), "one", 1),)
        return tuple(step(prefix + m.name, m.kind, m.count, many, (*above, kind)) for m in types[kind])

    steps = inside(name, "", False, ())
    return Plan(tuple(leaves), steps, {leaf.path for leaf in leaves if leaf.kind == "time"})


def _least(step: Step) -> int:
    """Bytes that a member takes at least; a sequence may be only its count."""
    return 4 if step.count == "many" else step.least * (1 if step.count == "one" else step.count)


@dataclass(frozen=True)
class Layout:
    """Where the fields of one payload lie, and which bytes another payload must share to be laid out so too."""

    plan: Plan
    big: bool
    """Big endian."""
    wide: int
    """Bytes of one wchar."""
    runs: tuple[tuple[tuple[int, int], ...], ...]
    """Leaf -> (offset, bytes) of its runs."""
    lengths: tuple[tuple[int, bytes], ...]
    """(offset, bytes) of the counts of texts and sequences; that of the tail is not among them."""
    end: int
    """Where the last field ends."""
    head: bytes
    """The payload that was walked, up to the first blob or the tail: what is gathered at once."""
    tail: int
    """The leaf that ends the message and may be longer or shorter in the next, -1 for none."""

    @cached_property
    def signs(self) -> NDArray[np.intp]:
        """Offsets in `head` of what must be equal: byte order and counts."""
        places = [at + k for at, _ in self.lengths if at < len(self.head) for k in range(4)]
        return np.array([0, 1, *places], np.intp)

    @cached_property
    def letters(self) -> NDArray[np.intp]:
        """Offsets in `head` of the bytes of texts."""
        places = [np.arange(at, at + size) for leaf, runs in zip(self.plan.leaves, self.runs, strict=True)
                  if leaf.kind in ("text", "wide") for at, size in runs if at + size <= len(self.head)]
        return np.concatenate([np.zeros(0, np.intp), *places]).astype(np.intp)


class Walk:
    """Reads one payload from its start to its end and notes where everything is.

    Raises:
        ValueError: the payload does not fit the type.
    """

    def __init__(self, plan: Plan, payload: bytes, wide: int = 4) -> None:
        kind = int.from_bytes(payload[:2], "big") if len(payload) >= START else -1
        if kind not in (0, 1):
            name = _ENCAPSULATIONS.get(kind, "no CDR")
            raise ValueError(f"payload starts with {payload[:4].hex() or 'nothing'} ({name}), only plain CDR is read")
        self.plan, self.wide, self.big = plan, wide, kind == 0
        self.runs: list[list[tuple[int, int]]] = [[] for _ in plan.leaves]
        """Leaf -> (offset, bytes) of its runs."""
        self._payload, self._count = payload, struct.Struct(">I" if self.big else "<I").unpack_from
        self._at, self._left, self._size = START, MAX_RUNS, len(payload)
        self._lengths: list[int] = []
        self._last = -1
        self._steps(plan.steps)
        if not 0 <= self._size - self._at <= SLACK:
            raise ValueError(f"{self._size - self._at} B are left after the last field, which ends at byte {self._at}")

    def layout(self) -> Layout:
        """What another payload must share to be laid out like this one."""
        tail = self._tail()
        stops = [at for k, (leaf, runs) in enumerate(zip(self.plan.leaves, self.runs, strict=True))
                 if leaf.kind == "blob" or k == tail for at, _ in runs]
        head = min([self._at, *stops])
        lengths = self._lengths[:-1] if tail >= 0 else self._lengths
        return Layout(self.plan, self.big, self.wide, tuple(map(tuple, self.runs)),
                      tuple((at, self._payload[at : at + 4]) for at in lengths), self._at, self._payload[:head], tail)

    def _tail(self) -> int:
        """The last leaf, if it is one text or blob that nothing follows."""
        if self._last < 0 or self.plan.leaves[self._last].kind not in ("text", "blob"):
            return -1
        runs = self.runs[self._last]
        alone = len(runs) == 1 and sum(runs[0]) == self._at and self._lengths[-1] == runs[0][0] - 4
        return self._last if alone else -1

    def _length(self, least: int) -> int:
        """A count, which the rest of the payload must have room for."""
        at = self._at + -(self._at - START) % 4
        if at + 4 > self._size:
            raise ValueError(f"a count at byte {at} is cut off, the payload has {self._size} B")
        (count,) = self._count(self._payload, at)
        self._at = at + 4
        self._room(count, least)
        self._lengths.append(at)
        return count

    def _room(self, count: int, least: int) -> None:
        if count * least > self._size - self._at:
            raise ValueError(f"{count} elements at byte {self._at} do not fit in a payload of {self._size} B")

    def _steps(self, steps: tuple[Step, ...]) -> None:
        for step in steps:
            count = step.count
            if count == "many":
                count = self._length(step.least)
            elif count == "one":
                count = 1
            else:
                self._room(count, step.least)
            if step.leaf < 0:
                for _ in range(count):
                    self._spend()
                    self._steps(step.inner)
                continue
            leaf = self.plan.leaves[step.leaf]
            if leaf.kind == "text" or leaf.kind == "wide":
                for _ in range(count):
                    self._text(step.leaf, leaf)
            else:
                if count and leaf.size > 1:
                    self._at += -(self._at - START) % (4 if leaf.kind == "time" else leaf.size)
                self._run(step.leaf, leaf, count * leaf.size)

    def _text(self, number: int, leaf: Leaf) -> None:
        width = self.wide if leaf.kind == "wide" else 1
        size = self._length(width) * width
        if width == 1 and size and self._payload[self._at + size - 1]:
            raise ValueError(f"the text at byte {self._at} has no closing zero byte")
        self._run(number, leaf, size)

    def _spend(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise ValueError(f"more than {MAX_RUNS} separate fields")

    def _run(self, number: int, leaf: Leaf, size: int) -> None:
        self._spend()
        at = self._at
        if at + size > self._size:
            raise ValueError(f"field of {size} B at byte {at} of a payload of {self._size} B")
        runs = self.runs[number]
        if runs and leaf.kind in ("number", "time", "blob") and sum(runs[-1]) == at:
            runs[-1] = (runs[-1][0], runs[-1][1] + size)
        else:
            runs.append((at, size))
        self._at = at + size
        self._last = number
