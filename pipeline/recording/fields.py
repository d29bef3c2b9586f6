"""Fields of MCAP records: read with their bounds checked, ValueError on what cannot be."""

import struct
from typing import NamedTuple


class Chunk(NamedTuple):
    """A chunk's header and where its packed bytes lie."""

    offset: int
    """Where its record starts."""
    size: int
    """Plain bytes."""
    crc: int
    """Of the plain bytes; 0 where there is none."""
    compression: str
    start: int
    stop: int
    first_ns: int
    last_ns: int


class Attached(NamedTuple):
    """An attachment's header and where its content lies."""

    name: str
    media_type: str
    start: int
    stop: int


def text(data: bytes, at: int, stop: int) -> tuple[str, int]:
    """A string with its length, and where it ends."""
    if at + 4 > stop:
        raise ValueError(f"string at byte {at} runs over its record")
    (size,) = struct.unpack_from("<I", data, at)
    if at + 4 + size > stop:
        raise ValueError(f"string of {size} B at byte {at} runs over its record")
    return data[at + 4 : at + 4 + size].decode(), at + 4 + size


def pairs(data: bytes, at: int, stop: int) -> tuple[dict[str, str], int]:
    """A map of strings, and where it ends."""
    (size,) = struct.unpack_from("<I", data, at)
    at, end = at + 4, at + 4 + size
    if end > stop:
        raise ValueError(f"map of {size} B at byte {at} runs over its record")
    values: dict[str, str] = {}
    while at < end:
        key, at = text(data, at, end)
        values[key], at = text(data, at, end)
    return values, at


def chunk(data: bytes, at: int, stop: int, offset: int) -> Chunk:
    """Header of the chunk whose content lies from `at` to `stop`; `offset` only names it."""
    first_ns, last_ns, size, crc, length = struct.unpack_from("<QQQII", data, at)
    name_end = at + 32 + length
    if name_end + 8 > stop:
        raise ValueError(f"compression name of {length} B")
    compression = data[at + 32 : name_end].decode()
    (packed,) = struct.unpack_from("<Q", data, name_end)
    if name_end + 8 + packed != stop:
        raise ValueError(f"{packed} packed bytes in a record of {stop - at}")
    return Chunk(offset, size, crc, compression, name_end + 8, stop, first_ns, last_ns)


def attachment(data: bytes, at: int, stop: int) -> Attached:
    """Header of the attachment whose content lies from `at` to `stop`, which may be beyond the end of `data`."""
    name, after = text(data, at + 16, stop)
    media_type, after = text(data, after, stop)
    (size,) = struct.unpack_from("<Q", data, after)
    if after + 8 + size + 4 != stop:
        raise ValueError(f"{size} B do not fit its record")
    return Attached(name, media_type, after + 8, stop - 4)
