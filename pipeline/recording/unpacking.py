"""Chunks unpacked: never more than their header declares, and no header that declares too much."""

import zlib
from pathlib import Path
from typing import Any

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard

from pipeline.errors import RecordingError
from pipeline.recording.errors import DAMAGED, REPACK, reading, refuse
from pipeline.recording.fields import Chunk, chunk

MAX_BYTES = 64 << 20
"""Largest record, and largest chunk once unpacked [B]."""
MAX_RATIO = 1000
"""Largest unpacked to packed size of a chunk above 1 MiB; state rows reach 2 to 5, a robot that stands still 200."""


def read_chunk(data: bytes, start: int, stop: int, at: int, where: Path) -> Chunk:
    """Header of the chunk record at byte `at` of the file, checked against the limits.

    Args:
        data: bytes that hold the record's content from `start` to `stop`.
        start: where the content starts in `data`.
        stop: where it ends.
        at: where the record starts in the file.
        where: the file.

    Raises:
        RecordingError: it is damaged, or declares more than a chunk may hold.
    """
    with reading(where, f"chunk at byte {at}"):
        found = chunk(data, start, stop, at)
        packed = found.stop - found.start
    if found.size > MAX_BYTES:
        raise absurd("chunk", at, found.size, where)
    if found.size > 1 << 20 and found.size > MAX_RATIO * packed:
        raise refuse(f"chunk at byte {at} declares {found.size} B out of {packed}, limit {MAX_RATIO} to 1", where,
                     "do not open it elsewhere: it is made to fill memory; ask its sender for the recording")
    return found


def plain_bytes(head: Chunk, packed: bytes | memoryview, where: Path, *, crc_needed: bool = True,
                zstd: zstandard.ZstdDecompressor | None = None) -> bytes:
    """Plain bytes of a chunk, its CRC checked.

    Args:
        head: the chunk's header.
        packed: its packed bytes.
        where: the file.
        crc_needed: a CRC field of 0 counts as a mismatch, not as "none was taken".
        zstd: one to use again, by one thread at a time; making one takes as long as 100 messages.

    Raises:
        RecordingError: it does not unpack to what the header says.
    """
    name = f"chunk at byte {head.offset}"
    with reading(where, name):
        match head.compression:
            case "":
                plain = bytes(packed)
            case "zstd":
                declared = zstandard.frame_content_size(packed)
                if declared not in (-1, head.size):
                    raise ValueError(f"header says {head.size} B, zstd frame says {declared} B")
                plain = (zstd or zstandard.ZstdDecompressor()).decompress(packed, max_output_size=head.size)
            case "lz4":
                plain = _lz4(packed, head.size)
            case other:
                raise refuse(f"{name} is packed with {other[:20]!r}", where, REPACK)
        if len(plain) != head.size:
            raise ValueError(f"{len(plain)} B of {head.size}")
    if (crc_needed or head.crc) and zlib.crc32(plain) != head.crc:
        raise refuse(f"{name}: CRC mismatch; quarantined", where, DAMAGED)
    return plain


def _lz4(packed: bytes | memoryview, size: int) -> bytes:
    library: Any = lz4.frame  # pyright: ignore[reportUnknownMemberType]
    # One byte more than declared: what is longer is told from what ends there.
    return library.decompress_chunk(library.create_decompression_context(), packed, max_length=size + 1)[0]


def absurd(kind: str, at: int, size: int, where: Path) -> RecordingError:
    """The error for a length that no recording has."""
    return refuse(f"{kind} at byte {at} declares {size} B, limit {MAX_BYTES}", where,
                  "fetch the recording again; if it is right, rewrite it in smaller chunks: mcap compress IN -o OUT")
