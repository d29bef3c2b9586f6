"""What a log gives: channels, and their messages in batches; and what was odd about it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

type Kind = Literal["damage", "summary", "unproven", "odd"]


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic as one writer published it; several channels may share a topic."""

    number: int
    topic: str
    encoding: str
    """Of the messages: cdr, json, protobuf, ..."""
    schema_name: str
    """Empty where the channel has no schema."""
    schema_encoding: str
    schema: bytes
    metadata: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Batch:
    """Messages of one channel out of one chunk, in file order; n of them."""

    channel: Channel
    data: bytes
    """Bytes that the payloads lie in, and those of other channels too."""
    starts: NDArray[np.int64]
    """Where each payload starts in `data`, shape (n,)."""
    sizes: NDArray[np.int64]
    """Payload bytes, shape (n,)."""
    log_ns: NDArray[np.int64]
    """When it was recorded [ns], shape (n,); 0 for messages that were latched."""
    publish_ns: NDArray[np.int64]
    """When it was published [ns], shape (n,)."""
    sequence: NDArray[np.uint32]
    """The publisher's counter, 0 where it has none, shape (n,)."""

    def __len__(self) -> int:
        return len(self.starts)

    def payload(self, k: int) -> memoryview:
        """Bytes of message k."""
        start = int(self.starts[k])
        return memoryview(self.data)[start : start + int(self.sizes[k])]


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that a log should not have and that does not keep it from being read."""

    what: str
    offset: int
    """Byte of the file."""
    kind: Kind
    """damage: something is lost; summary: the summary is not to be trusted, the data are; unproven: no CRC that
    would show damage; odd: not as the format asks."""


class Problems:
    """Problems of one reading; those of a sort are told once, with their number."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[Problem, int]] = {}

    def add(self, what: str, offset: int, kind: Kind) -> None:
        """Note one; `what` is the sort."""
        first, count = self._found.get(what, (Problem(what, offset, kind), 0))
        self._found[what] = (first, count + 1)

    def all(self) -> list[Problem]:
        """In the order in which they were first seen."""
        return [p if n == 1 else Problem(f"{p.what} ({n} times)", p.offset, p.kind) for p, n in self._found.values()]
