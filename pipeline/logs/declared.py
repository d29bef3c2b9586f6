"""Schemas and channels that a log declares."""

import struct
from collections.abc import Mapping
from types import MappingProxyType

from pipeline.logs.batch import Channel, Problems
from pipeline.recording.fields import pairs, text

MAX_DECLARED = 64 << 20
"""All schemas and channels of a log together [B]; message definitions of a large robot take below 1 MB."""


class Declared:
    """What was declared so far; a number means one thing throughout a file."""

    def __init__(self, problems: Problems) -> None:
        self.channels: dict[int, Channel] = {}
        self.outside = 0
        """Declarations that stand in no chunk, so that no chunk's CRC covers them."""
        self._problems = problems
        self._schemas: dict[int, tuple[str, str, bytes]] = {}
        self._raw: dict[tuple[str, int], bytes] = {}
        self._bytes = 0

    @property
    def schemas(self) -> int:
        """How many schemas."""
        return len(self._schemas)

    def schema(self, content: bytes, offset: int) -> None:
        """Take a schema record; ValueError where its number means something else already, or it is damaged."""
        (number,) = struct.unpack_from("<H", content)
        if self._is_new("schema", number, content):
            self._schemas[number] = _schema(content)
            if number == 0:
                self._problems.add("a schema has number 0, which stands for none", offset, "odd")

    def channel(self, content: bytes, offset: int) -> None:
        """Take a channel record; ValueError where its number means something else already, or it is damaged."""
        number, schema = struct.unpack_from("<HH", content)
        if self._is_new("channel", number, content):
            if schema and schema not in self._schemas:
                self._problems.add(f"channel {number} names schema {schema}, which was never declared", offset, "odd")
            self.channels[number] = _channel(content, self._schemas.get(schema, ("", "", b"")))

    def agrees(self, kind: str, content: bytes) -> bool:
        """Whether a record of the summary, 'schema' or 'channel', was declared so in the data."""
        return self._raw.get((kind, struct.unpack_from("<H", content)[0])) == content

    def _is_new(self, kind: str, number: int, content: bytes) -> bool:
        known = self._raw.get((kind, number))
        if known == content:
            return False
        if known is not None:
            raise ValueError(f"{kind} {number} is declared twice, differently")
        self._bytes += len(content)
        if self._bytes > MAX_DECLARED:
            raise ValueError(f"schemas and channels take more than {MAX_DECLARED} B")
        self._raw[kind, number] = content
        return True


def _schema(content: bytes) -> tuple[str, str, bytes]:
    stop = len(content)
    name, at = text(content, 2, stop)
    encoding, at = text(content, at, stop)
    (size,) = struct.unpack_from("<I", content, at)
    if at + 4 + size > stop:
        raise ValueError(f"definition of {size} B runs over its record")
    return name, encoding, content[at + 4 : at + 4 + size]


def _channel(content: bytes, schema: tuple[str, str, bytes]) -> Channel:
    stop = len(content)
    (number,) = struct.unpack_from("<H", content)
    topic, at = text(content, 4, stop)
    encoding, at = text(content, at, stop)
    values, _ = pairs(content, at, stop)
    metadata: Mapping[str, str] = MappingProxyType(values)
    return Channel(number, topic, encoding, *schema, metadata)
