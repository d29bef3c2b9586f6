"""A whole MCAP file from columns: every chunk's bytes come out of one array."""

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import zstandard
from numpy.typing import NDArray

from pipeline.recording import records
from pipeline.recording.columns import Column, Single
from pipeline.recording.dialect import (
    LIBRARY,
    MESSAGE_ENCODING,
    PROFILE,
    SCHEMA_ENCODING,
    definition,
    stamps_ns,
    topic_type,
)
from pipeline.recording.interleave import Block, interleave
from pipeline.recording.records import Op

CHUNK_BYTES = 1 << 18
"""Plain size of a chunk: 3 to 4 s of robot time, which a cut file loses at worst. 1 MiB saves 0.5 % of the disk,
64 KiB costs 2 to 4 %."""
ZSTD_LEVEL = 1
"""Rows of float64 hardly compress: level 3 takes a quarter more time for at most 0.5 %."""
_MEDIA = {".xml": "application/xml", ".urdf": "application/xml", ".json": "application/json"}


@dataclass(slots=True)
class Assembly:
    """A file on its way: pieces in order, and what the summary will say of them."""

    pieces: list[bytes] = field(default_factory=list[bytes])
    offset: int = 0
    crc: int = 0
    groups: dict[Op, list[bytes]] = field(default_factory=dict[Op, list[bytes]])
    counts: dict[int, int] = field(default_factory=dict[int, int])

    def add(self, piece: bytes) -> int:
        """Append bytes of the data section; returns where they start."""
        start = self.offset
        self.pieces.append(piece)
        self.offset += len(piece)
        self.crc = zlib.crc32(piece, self.crc)
        return start

    def mention(self, group: Op, content: bytes) -> None:
        """Keep a record for the summary."""
        self.groups.setdefault(group, []).append(content)


def assemble(columns: Sequence[Column], singles: Sequence[Single], *, ticks: int, hz: float,
             metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]) -> Assembly:
    """All bytes of a recording, in pieces.

    Metadata and attachments come first, so that a file cut short still says which attempt it was.

    Args:
        columns: topics with one message a tick.
        singles: the other messages, in time order.
        ticks: number of rows of every column.
        hz: control rate [Hz].
        metadata: record name -> strings.
        attachments: file name -> content.
    """
    file = Assembly()
    stamps = np.array(stamps_ns(ticks + 1, hz), np.uint64)
    file.add(records.MAGIC + records.header(PROFILE, LIBRARY))
    add_extras(file, metadata, attachments, int(stamps[0]))
    head, numbers = _declare(file, [c.topic for c in columns] + [s.topic for s in singles])
    block, starts = interleave(columns, numbers, stamps[:-1])
    writer = _Chunks(file, numbers, tuple(numbers[c.topic] for c in columns), np.array(starts, np.uint64), stamps)
    step = max(1, CHUNK_BYTES // block.shape[1])
    for a in range(0, ticks, step):
        b = min(a + step, ticks)
        inside = [s for s in singles if a <= s.tick < b or s.tick >= b == ticks]
        writer.add(head if a == 0 else b"", block[a:b], a, inside)
    end = max([ticks - 1, *(s.tick for s in singles)])
    finish(file, numbers, len(metadata), len(attachments), int(stamps[0]), int(stamps[end]))
    return file


def add_extras(file: Assembly, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes],
               start_ns: int) -> None:
    """Metadata records and attachments, and their places for the summary."""
    for name, values in metadata.items():
        data = records.metadata(name, values)
        index = struct.pack("<QQ", file.add(data), len(data)) + records.text(name)
        file.mention(Op.METADATA_INDEX, records.record(Op.METADATA_INDEX, index))
    for name, content in attachments.items():
        media = next((m for suffix, m in _MEDIA.items() if name.endswith(suffix)), "application/octet-stream")
        data = records.attachment(name, media, content, start_ns)
        index = struct.pack("<QQQQQ", file.add(data), len(data), start_ns, start_ns, len(content))
        index += records.text(name) + records.text(media)
        file.mention(Op.ATTACHMENT_INDEX, records.record(Op.ATTACHMENT_INDEX, index))


def _declare(file: Assembly, topics: Sequence[str]) -> tuple[bytes, dict[str, int]]:
    """Schemas and channels as they stand in the first chunk, and topic -> channel number."""
    numbers = {topic: number for number, topic in enumerate(dict.fromkeys(topics), start=1)}
    schemas = {name: n for n, name in enumerate(dict.fromkeys(topic_type(t) for t in numbers), start=1)}
    for name, number in schemas.items():
        file.mention(Op.SCHEMA, records.schema(number, name, SCHEMA_ENCODING, definition(name)))
    for topic, number in numbers.items():
        channel = records.channel(number, schemas[topic_type(topic)], topic, MESSAGE_ENCODING)
        file.mention(Op.CHANNEL, channel)
    return b"".join(file.groups[Op.SCHEMA] + file.groups[Op.CHANNEL]), numbers


@dataclass(frozen=True, slots=True)
class _Chunks:
    """Cuts the block into chunk records, each followed by its message index."""

    file: Assembly
    numbers: Mapping[str, int]
    channels: tuple[int, ...]
    """Channel number of every message of a tick."""
    starts: NDArray[np.uint64]
    """Where those messages start within the tick's bytes."""
    stamps: NDArray[np.uint64]
    compressor: zstandard.ZstdCompressor = field(default_factory=lambda: zstandard.ZstdCompressor(level=ZSTD_LEVEL))

    def add(self, head: bytes, block: Block, first: int, singles: Sequence[Single]) -> None:
        """One chunk: `head`, then ticks first.. of `block` with the singles before their ticks."""
        pieces: list[bytes | memoryview] = [head]
        shift = np.full(len(block), len(head), np.uint64)
        odd: dict[int, list[tuple[int, int]]] = {}
        done, at = 0, len(head)
        for single in singles:
            row = min(single.tick - first, len(block))
            pieces.append(block[done:row].data)
            at += (row - done) * block.shape[1]
            done = row
            number, stamp = self.numbers[single.topic], int(self.stamps[single.tick])
            message = records.message(number, single.tick, stamp, single.payload)
            odd.setdefault(number, []).append((stamp, at))
            pieces.append(message)
            at += len(message)
            shift[row:] += np.uint64(len(message))
        pieces.append(block[done:].data)
        plain = b"".join(pieces)
        rows = shift + np.arange(len(block), dtype=np.uint64) * np.uint64(block.shape[1])
        stamps = self.stamps[first : first + len(block)]
        end = max([int(stamps[-1]), *(t for entries in odd.values() for t, _ in entries)])
        self._write(plain, int(stamps[0]), end, stamps, rows, odd)

    def _write(self, plain: bytes, start_ns: int, end_ns: int, stamps: NDArray[np.uint64], rows: NDArray[np.uint64],
               odd: Mapping[int, list[tuple[int, int]]]) -> None:
        index, offsets = self._index(stamps, rows, odd)
        seal_chunk(self.file, plain, (start_ns, end_ns), index, offsets, self.compressor)

    def _index(self, stamps: NDArray[np.uint64], rows: NDArray[np.uint64],
               odd: Mapping[int, list[tuple[int, int]]]) -> tuple[bytes, dict[int, int]]:
        """Message index records of a chunk, and channel -> where its record starts among them."""
        n, counts = len(rows), self.file.counts
        head = [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("size", "<u4")]
        regular = np.zeros(len(self.channels), np.dtype([*head, ("entries", "<u8", (n, 2))]))
        regular["op"], regular["length"], regular["size"] = Op.MESSAGE_INDEX, 6 + 16 * n, 16 * n
        regular["channel"] = self.channels
        regular["entries"][..., 0] = stamps
        regular["entries"][..., 1] = rows + self.starts[:, None]
        offsets = {number: k * regular.itemsize for k, number in enumerate(self.channels)}
        data = regular.tobytes()
        for number in self.channels:
            counts[number] = counts.get(number, 0) + n
        for number, entries in odd.items():
            offsets[number] = len(data)
            content = struct.pack("<HI", number, 16 * len(entries)) + b"".join(struct.pack("<QQ", *e) for e in entries)
            data += records.record(Op.MESSAGE_INDEX, content)
            counts[number] = counts.get(number, 0) + len(entries)
        return data, offsets


def seal_chunk(file: Assembly, plain: bytes, span_ns: tuple[int, int], index: bytes, offsets: Mapping[int, int],
               compressor: zstandard.ZstdCompressor) -> None:
    """One chunk record, its message index, and its entry for the summary.

    Args:
        file: the file on its way.
        plain: records of the chunk.
        span_ns: earliest and latest log time [ns].
        index: message index records.
        offsets: channel -> where its record starts in `index`.
        compressor: packs `plain`.
    """
    packed = compressor.compress(plain)
    chunk = records.chunk(*span_ns, len(plain), zlib.crc32(plain), "zstd", packed)
    chunk_start = file.add(chunk)
    index_start = file.add(index)
    table = b"".join(struct.pack("<HQ", number, index_start + offset) for number, offset in offsets.items())
    content = struct.pack("<QQQQI", *span_ns, chunk_start, len(chunk), len(table)) + table
    content += struct.pack("<Q", len(index)) + records.text("zstd") + struct.pack("<QQ", len(packed), len(plain))
    file.mention(Op.CHUNK_INDEX, records.record(Op.CHUNK_INDEX, content))


def finish(file: Assembly, numbers: Mapping[str, int], metadata: int, attachments: int, start_ns: int,
           end_ns: int) -> None:
    """End of the data section, summary, footer."""
    counts = b"".join(struct.pack("<HQ", number, count) for number, count in sorted(file.counts.items()))
    groups = file.groups
    statistics = struct.pack("<QHIIIIQQI", sum(file.counts.values()), len(groups[Op.SCHEMA]), len(numbers), attachments,
                             metadata, len(groups[Op.CHUNK_INDEX]), start_ns, end_ns, len(counts)) + counts
    file.mention(Op.STATISTICS, records.record(Op.STATISTICS, statistics))
    file.add(records.record(Op.DATA_END, struct.pack("<I", file.crc)))
    summary_start, summary, offsets = file.offset, b"", b""
    for op, entries in file.groups.items():
        group = b"".join(entries)
        place = struct.pack("<BQQ", op, summary_start + len(summary), len(group))
        offsets += records.record(Op.SUMMARY_OFFSET, place)
        summary += group
    offsets_start = summary_start + len(summary)
    file.add(summary + offsets + records.footer(summary_start, offsets_start, summary + offsets) + records.MAGIC)
