"""MCAP records as bytes. Source: the MCAP format specification, version 0 (mcap.dev/spec)."""

import struct
import zlib
from collections.abc import Mapping
from enum import IntEnum

MAGIC = b"\x89MCAP0\r\n"
FOOTER_BYTES = 9 + 20
"""A footer record, its opcode and length included."""


class Op(IntEnum):
    """Record types."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""opcode, length, channel, sequence, log time, publish time: what stands before a message's payload."""
MESSAGE_FIELDS = 22
"""Bytes of a message's content that are not payload."""


def record(op: Op, content: bytes) -> bytes:
    """Any record: opcode, length, content."""
    return struct.pack("<BQ", op, len(content)) + content


def text(value: str) -> bytes:
    """A string with its length."""
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def pairs(values: Mapping[str, str]) -> bytes:
    """A map of strings with its length in bytes."""
    data = b"".join(text(key) + text(value) for key, value in values.items())
    return struct.pack("<I", len(data)) + data


def header(profile: str, library: str) -> bytes:
    """First record of a file."""
    return record(Op.HEADER, text(profile) + text(library))


def schema(number: int, name: str, encoding: str, data: str) -> bytes:
    """A message definition."""
    return record(Op.SCHEMA, struct.pack("<H", number) + text(name) + text(encoding) + text(data))


def channel(number: int, schema_number: int, topic: str, encoding: str) -> bytes:
    """A topic and the schema of its messages."""
    return record(Op.CHANNEL, struct.pack("<HH", number, schema_number) + text(topic) + text(encoding) + pairs({}))


def message(channel_number: int, sequence: int, stamp_ns: int, payload: bytes) -> bytes:
    """One message, logged when it was published."""
    size = MESSAGE_FIELDS + len(payload)
    return MESSAGE_HEAD.pack(Op.MESSAGE, size, channel_number, sequence, stamp_ns, stamp_ns) + payload


def metadata(name: str, values: Mapping[str, str]) -> bytes:
    """Named strings."""
    return record(Op.METADATA, text(name) + pairs(values))


def attachment(name: str, media_type: str, data: bytes, stamp_ns: int) -> bytes:
    """A file inside the file, with a CRC of its own."""
    content = struct.pack("<QQ", stamp_ns, stamp_ns) + text(name) + text(media_type)
    content += struct.pack("<Q", len(data)) + data
    return record(Op.ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))


def chunk(start_ns: int, end_ns: int, size: int, crc: int, compression: str, data: bytes) -> bytes:
    """Messages, compressed together; size and CRC are those of the plain bytes."""
    head = struct.pack("<QQQI", start_ns, end_ns, size, crc) + text(compression) + struct.pack("<Q", len(data))
    return struct.pack("<BQ", Op.CHUNK, len(head) + len(data)) + head + data


def footer(summary_start: int, offsets_start: int, summary: bytes) -> bytes:
    """Last record; its CRC covers the summary and the footer's own first fields."""
    head = struct.pack("<BQQQ", Op.FOOTER, 20, summary_start, offsets_start)
    return head + struct.pack("<I", zlib.crc32(head, zlib.crc32(summary)))
