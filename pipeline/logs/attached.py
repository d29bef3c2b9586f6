"""Metadata and attachments of a log, chunks passed over."""

import struct
import zlib
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

from pipeline.errors import RecordingError
from pipeline.logs.bounds import MAX_RECORDS, too_many
from pipeline.logs.source import BLOCK, Source
from pipeline.recording.errors import DAMAGED, not_mcap, reading, refuse
from pipeline.recording.fields import Attached, attachment, pairs, text
from pipeline.recording.records import MAGIC, MESSAGE_HEAD, Op
from pipeline.recording.unpacking import MAX_BYTES, absurd


def read_metadata(stream: FileIO, size: int, where: Path) -> list[tuple[str, dict[str, str]]]:
    """Metadata records up to the end of data, or as far as the file goes."""
    found: list[tuple[str, dict[str, str]]] = []
    for offset, content in _contents(stream, size, where, Op.METADATA):
        with reading(where, f"metadata at byte {offset}"):
            name, at = text(content, 0, len(content))
            found.append((name, pairs(content, at, len(content))[0]))
    return found


def read_attachments(stream: FileIO, size: int, where: Path) -> Iterator[tuple[str, str, bytes]]:
    """Name, media type and content of attachments, their CRCs checked where they have one."""
    for offset, content in _contents(stream, size, where, Op.ATTACHMENT):
        with reading(where, f"attachment at byte {offset}"):
            head = attachment(content, 0, len(content))
            (crc,) = struct.unpack_from("<I", content, head.stop)
        if crc and crc != zlib.crc32(memoryview(content)[: head.stop]):
            raise _mismatch(offset, where)
        yield head.name, head.media_type, content[head.start : head.stop]


def pass_attachment(source: Source, size: int, where: Path) -> tuple[Attached, int] | None:
    """Read over the attachment whose record, of `size` bytes, lies at the window's place; block by block.

    Returns:
        Its header and its CRC, which is right, or 0 where it has none; None where the file ends within it.
    """
    offset = source.offset
    if source.left < 9 + size:
        return None
    source.fill(min(9 + size, BLOCK))
    source.at += 9
    with reading(where, f"attachment at byte {offset}"):
        head = attachment(source.data, source.at, source.at + size)
    crc, left = 0, size - 4
    while left > 0:
        step = min(left, BLOCK)
        if not source.fill(step):
            return None
        crc = zlib.crc32(memoryview(source.data)[source.at : source.at + step], crc)
        source.at += step
        left -= step
    if not source.fill(4):
        return None
    (stored,) = struct.unpack_from("<I", source.data, source.at)
    source.at += 4
    if stored and stored != crc:
        raise _mismatch(offset, where)
    return head, stored


def _mismatch(offset: int, where: Path) -> RecordingError:
    return refuse(f"attachment at byte {offset} is damaged: CRC mismatch", where, DAMAGED)


def _contents(stream: FileIO, size: int, where: Path, wanted: Op) -> Iterator[tuple[int, bytes]]:
    """Where each record of one type starts, and its content."""
    most = MAX_RECORDS + size // MESSAGE_HEAD.size
    source, room = Source(stream, size), most
    if not source.fill(len(MAGIC)) or source.data[: len(MAGIC)] != MAGIC:
        raise not_mcap(where)
    source.at = len(MAGIC)
    while source.fill(9):
        op, length = struct.unpack_from("<BQ", source.data, source.at)
        room -= 1
        if op in (0, Op.FOOTER, Op.DATA_END):
            return
        if room < 0:
            raise too_many(most, source.offset, where)
        if op != wanted:
            if not source.jump(9 + length):
                return
            continue
        offset = source.offset
        if length > MAX_BYTES:
            raise absurd("record", offset, length, where)
        if not source.fill(9 + length):
            return
        content = source.data[source.at + 9 : source.at + 9 + length]
        source.at += 9 + length
        yield offset, content
