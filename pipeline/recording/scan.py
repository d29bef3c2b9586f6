"""Look at a file before anything is unpacked: where its records lie, and whether it asks for too much."""

import stat
import struct
import zlib
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import zstandard

from pipeline.errors import RecordingError
from pipeline.recording.records import MAGIC, Op

MAX_BYTES = 64 << 20
"""Largest record, and largest chunk once unpacked [B]."""
MAX_TOTAL = 256 << 20
"""All chunks of a file together, unpacked [B]; half an hour of the arm at 20 Hz takes 150 MB."""
MAX_RECORDS = 500_000
"""Top-level records; keeps a file of empty ones from holding a core."""
MAX_RATIO = 1000
"""Largest unpacked to packed size of a chunk above 1 MiB; state rows reach 2 to 5, a robot that stands still 200."""


class Chunk(NamedTuple):
    """A chunk's header and where its packed bytes lie."""

    offset: int
    size: int
    crc: int
    compression: str
    start: int
    stop: int


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


def refuse(what: str, where: object, mend: str) -> RecordingError:
    """A RecordingError."""
    return RecordingError(what, where=where, mend=mend)


_SPLIT = "split it: mcap filter IN -o OUT --start ... --end ..."
_REPACK = "repack it: mcap compress IN -o OUT"
DAMAGED = "fetch the recording again from its robot, or drop the episode: damaged data is never used"


@contextmanager
def reading(where: Path, part: str) -> Generator[None]:
    """One error for whatever the libraries below raise: ZstdError, struct.error, UnicodeDecodeError, ..."""
    try:
        yield
    except RecordingError:
        raise
    except OSError as error:
        raise refuse(f"{part} cannot be read: {error.strerror}", where, "check the path and its permissions") from error
    except Exception as error:
        cause = " ".join(str(error).split()) or type(error).__name__
        raise refuse(f"{part} is damaged: {cause[:200]}", where, DAMAGED) from error


def load(path: Path) -> bytes:
    """The bytes of a file no larger than any recording may be."""
    with reading(path, "file"):
        status = path.stat()
        if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
            raise refuse("not a regular file", path, "name a .mcap recording")
        size = status.st_size
        if size > MAX_TOTAL:
            raise refuse(f"file has {size} B, limit {MAX_TOTAL}", path, _SPLIT)
        return path.read_bytes()


def scan(data: bytes, where: Path) -> Scan:
    """Walk the top-level records up to the end of the data section.

    Nothing is unpacked. Lengths, unpacked sizes, ratios and their sum are checked against the limits, the
    CRC over the data section is compared; what is behind it, the summary, is not looked at.

    Raises:
        RecordingError: not an MCAP file, or one that asks for more than the limits allow.
    """
    if not data.startswith(MAGIC):
        raise refuse("not an MCAP file (bad magic at byte 0)", where,
                     "name a .mcap recording; older bags are converted by: mcap convert IN OUT.mcap")
    found, at, total, count = Scan(data, where), len(MAGIC), 0, 0
    while at + 9 <= len(data):
        count += 1
        if count > MAX_RECORDS:
            raise refuse(f"more than {MAX_RECORDS} records up to byte {at}", where, _SPLIT)
        op, size = struct.unpack_from("<BQ", data, at)
        start, stop = at + 9, at + 9 + size
        if op == 0 or op == Op.FOOTER:
            found.end = f"no end of data before the record at byte {at}"
            break
        if size > MAX_BYTES + 64:
            raise _absurd("chunk" if op == Op.CHUNK else "record", at, size, where)
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
            chunk = _chunk(data, at, start, stop, where)
            total += chunk.size
            if total > MAX_TOTAL:
                raise refuse(f"chunks up to byte {stop} declare {total} B together, limit {MAX_TOTAL}", where,
                             _SPLIT)
            found.chunks.append(chunk)
        elif op == Op.METADATA:
            found.metadata.append((start, stop))
        elif op == Op.ATTACHMENT:
            found.attachments.append((start, stop))
        elif op == Op.MESSAGE:
            raise refuse(f"message at byte {at} is outside any chunk", where, _REPACK)
        at = stop
    return found


def unpack(chunk: Chunk, found: Scan) -> bytes:
    """Plain bytes of a chunk, its CRC checked; never more than its header declares."""
    where, name = found.where, f"chunk at byte {chunk.offset}"
    packed = memoryview(found.data)[chunk.start : chunk.stop]
    with reading(where, name):
        if chunk.compression == "":
            plain = bytes(packed)
        elif chunk.compression == "zstd":
            declared = zstandard.frame_content_size(packed)
            if declared not in (-1, chunk.size):
                raise ValueError(f"header says {chunk.size} B, zstd frame says {declared} B")
            plain = zstandard.ZstdDecompressor().decompress(packed, max_output_size=chunk.size)
        else:
            raise refuse(f"{name} is packed with {chunk.compression[:20]!r}", where, _REPACK)
        if len(plain) != chunk.size:
            raise ValueError(f"{len(plain)} B of {chunk.size}")
    if zlib.crc32(plain) != chunk.crc:
        raise refuse(f"{name}: CRC mismatch; quarantined", where, DAMAGED)
    return plain


def _chunk(data: bytes, at: int, start: int, stop: int, where: Path) -> Chunk:
    with reading(where, f"chunk at byte {at}"):
        _, _, size, crc, length = struct.unpack_from("<QQQII", data, start)
        if size > MAX_BYTES:
            raise _absurd("chunk", at, size, where)
        name_end = start + 32 + length
        if name_end + 8 > stop:
            raise ValueError(f"compression name of {length} B")
        compression = data[start + 32 : name_end].decode()
        (packed,) = struct.unpack_from("<Q", data, name_end)
        first = name_end + 8
        if first + packed != stop:
            raise ValueError(f"{packed} packed bytes in a record of {stop - start}")
        if size > 1 << 20 and size > MAX_RATIO * packed:
            raise refuse(f"chunk at byte {at} declares {size} B out of {packed}, limit {MAX_RATIO} to 1", where,
                         "do not open it elsewhere: it is made to fill memory; ask its sender for the recording")
    return Chunk(at, size, crc, compression, first, stop)


def _absurd(kind: str, at: int, size: int, where: Path) -> RecordingError:
    return refuse(f"{kind} at byte {at} declares {size} B, limit {MAX_BYTES}", where,
                  "fetch the recording again; if it is right, rewrite it in smaller chunks: mcap compress IN -o OUT")
