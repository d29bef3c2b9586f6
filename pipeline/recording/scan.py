"""Look at a file before anything is unpacked: where its records lie, and whether it asks for too much."""

import mmap
import stat
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from pipeline.recording.errors import DAMAGED, REPACK, SPLIT, not_mcap, reading, refuse
from pipeline.recording.fields import Chunk
from pipeline.recording.records import MAGIC, Op
from pipeline.recording.unpacking import MAX_BYTES, absurd, plain_bytes, read_chunk

__all__ = ["DAMAGED", "Scan", "load", "reading", "refuse", "scan", "unpack"]

MAX_TOTAL = 256 << 20
"""All chunks of a file together, unpacked, and what of a file is held in memory [B]; half an hour of the arm at 20 Hz
takes 150 MB. Pictures may go beyond it: they hardly pack, so a file may declare a few times its own size."""
MAX_FILE = 16 << 30
"""Largest file [B]: an hour of eight cameras."""
_SPREAD = 4
"""How many times its own size a file above MAX_TOTAL may unpack to."""
MAX_RECORDS = 500_000
"""Top-level records; keeps a file of empty ones from holding a core."""


@dataclass(slots=True)
class Scan:
    """Records of the data section, by place."""

    data: bytes
    where: Path
    metadata: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])
    attachments: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])
    chunks: list[Chunk] = field(default_factory=list[Chunk])
    end: str | None = "the file ends"
    """Why the data section ends before its end; None where it is whole."""
    sound: bool = False
    """The CRC over the whole data section is right."""


def load(path: Path) -> bytes:
    """The bytes of a file no larger than any recording may be; a large one is mapped, not read."""
    with reading(path, "file"):
        status = path.stat()
        if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
            raise refuse("not a regular file", path, "name a .mcap recording")
        size = status.st_size
        if size > MAX_FILE:
            raise refuse(f"file has {size} B, limit {MAX_FILE}", path, SPLIT)
        if size <= MAX_TOTAL:
            return path.read_bytes()
        with path.open("rb") as stream:  # a map stands where bytes do: slices and buffers are all that is asked of it
            return cast(bytes, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))


def scan(data: bytes, where: Path) -> Scan:
    """Walk the top-level records up to the end of the data section.

    Nothing is unpacked. Lengths, unpacked sizes, ratios and their sum are checked against the limits, the
    CRC over the data section is compared; what is behind it, the summary, is not looked at.

    Raises:
        RecordingError: not an MCAP file, or one that asks for more than the limits allow.
    """
    if data[: len(MAGIC)] != MAGIC:
        raise not_mcap(where)
    found, at, total, count = Scan(data, where), len(MAGIC), 0, 0
    limit = max(MAX_TOTAL, _SPREAD * len(data))
    while at + 9 <= len(data):
        count += 1
        if count > MAX_RECORDS:
            raise refuse(f"more than {MAX_RECORDS} records up to byte {at}", where, SPLIT)
        op, size = struct.unpack_from("<BQ", data, at)
        start, stop = at + 9, at + 9 + size
        if op == 0 or op == Op.FOOTER:
            found.end = f"no end of data before the record at byte {at}"
            break
        if size > MAX_BYTES + 64:
            raise absurd("chunk" if op == Op.CHUNK else "record", at, size, where)
        if stop > len(data):
            break
        if op == Op.DATA_END:
            found.end = None
            with reading(where, f"end of data at byte {at}"):
                (crc,) = struct.unpack_from("<I", data, start) if size >= 4 else (0,)
            found.sound = crc == zlib.crc32(memoryview(data)[:at])
            if crc == 0 and not found.sound:
                raise refuse("recording has no CRC over its data", where,
                             "write it with data CRCs (enable_data_crcs=True)")
            break
        if op == Op.CHUNK:
            chunk = read_chunk(data, start, stop, at, where)
            total += chunk.size
            if total > limit:
                raise refuse(f"chunks up to byte {stop} declare {total} B together, limit {limit}", where, SPLIT)
            found.chunks.append(chunk)
        elif op == Op.METADATA:
            found.metadata.append((start, stop))
        elif op == Op.ATTACHMENT:
            found.attachments.append((start, stop))
        elif op == Op.MESSAGE:
            raise refuse(f"message at byte {at} is outside any chunk", where, REPACK)
        at = stop
    return found


def unpack(chunk: Chunk, found: Scan) -> bytes:
    """Plain bytes of a chunk, its CRC checked; never more than its header declares."""
    return plain_bytes(chunk, memoryview(found.data)[chunk.start : chunk.stop], found.where)
