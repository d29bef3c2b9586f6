"""The data section of a log: its messages in pieces, everything else counted and checked on the way."""

import struct
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from pipeline.errors import RecordingError
from pipeline.logs.attached import pass_attachment
from pipeline.logs.batch import Problems
from pipeline.logs.bounds import Bounds
from pipeline.logs.declared import MAX_DECLARED, Declared
from pipeline.logs.source import Source
from pipeline.logs.tally import Tally
from pipeline.logs.walk import PIECE, heads, message_run
from pipeline.recording.errors import DAMAGED, not_mcap, reading, refuse
from pipeline.recording.fields import Chunk, pairs, text
from pipeline.recording.records import MAGIC, MESSAGE_FIELDS, Op
from pipeline.recording.unpacking import MAX_BYTES, absurd, plain_bytes, read_chunk

MAX_NAMED = 10_000
PRIVATE = 0x80
"""From this opcode on records are an application's own."""


class Piece(NamedTuple):
    """Messages that lie in the same plain bytes, in file order."""

    data: bytes
    starts: NDArray[np.int64]
    """Where each message's record starts, shape (n,)."""
    heads: NDArray[np.void]
    """Fields before the payloads, see walk.HEAD, shape (n,)."""


class Section:
    """One pass over the data section."""

    def __init__(self, source: Source, declared: Declared, problems: Problems, where: Path, *, tolerant: bool) -> None:
        self.tally = Tally()
        self.end: str | None = "the file ends"
        """Why the section ends before its end; None where it is whole."""
        self.crc = 0
        """Over the whole section, proven; 0 where there is none."""
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.attached: list[tuple[str, int]] = []
        """Name and size of the first MAX_NAMED attachments."""
        self._source, self._declared, self._problems, self._where = source, declared, problems, where
        self._tolerant = tolerant
        self._bounds = Bounds(source.size, where)
        self._metadata_bytes = 0
        self._zstd = zstandard.ZstdDecompressor()

    def pieces(self) -> Iterator[Piece]:
        """Every message; RecordingError on damage and on what asks for too much."""
        source, starts = self._source, array("q")
        if not source.fill(len(MAGIC)) or source.data[: len(MAGIC)] != MAGIC:
            raise not_mcap(self._where)
        source.at = len(MAGIC)
        while True:
            if starts and (len(starts) >= PIECE or not self._stands()):
                yield self._loose(starts)
            if not source.fill(9):
                return
            op, size = struct.unpack_from("<BQ", source.data, source.at)
            if not self._admit(op, size):
                break
            if op == Op.MESSAGE:
                if not source.fill(9 + size):
                    return
                source.at = message_run(source.data, source.at, starts)
            elif op == Op.CHUNK:
                if starts:
                    yield self._loose(starts)
                if not source.fill(9 + size):
                    return
                yield from self._messages(self._chunk(size))
                if self.end != "the file ends":
                    return
            elif not self._other(op, size) or op == Op.DATA_END:
                break
        if starts:
            yield self._loose(starts)

    def _stands(self) -> bool:
        """Whether the next record lies in the window as it is."""
        source = self._source
        return source.holds(9) and source.holds(9 + struct.unpack_from("<Q", source.data, source.at + 1)[0])

    def _admit(self, op: int, size: int) -> bool:
        """Whether the section goes on; RecordingError where the record cannot be."""
        offset = self._source.offset
        if op in (0, Op.FOOTER):
            self.end = f"no end of data before the record at byte {offset}"
            return False
        if size > MAX_BYTES + 64 and (op != Op.ATTACHMENT or size > self._source.left):
            raise absurd("chunk" if op == Op.CHUNK else "record", offset, size, self._where)
        if op != Op.MESSAGE:
            self._bounds.record(offset)
        elif size < MESSAGE_FIELDS:
            raise refuse(f"message at byte {offset} has {size} B", self._where, DAMAGED)
        return True

    def _loose(self, starts: "array[int]") -> Piece:
        """Messages outside of chunks."""
        self.tally.bare += len(starts)
        piece = Piece(self._source.data, *heads(self._source.data, starts))
        self.tally.see(piece.heads["log"])
        return piece

    def _chunk(self, size: int) -> Chunk:
        """Header of the chunk at the window's place, within the limits."""
        source = self._source
        chunk = read_chunk(source.data, source.at + 9, source.at + 9 + size, source.offset, self._where)
        self._bounds.unpack(chunk.size, source.offset)
        source.at += 9 + size
        return chunk

    def _messages(self, chunk: Chunk) -> Iterator[Piece]:
        """Messages of a chunk; where it is damaged, either the error or the end of what is read."""
        try:
            packed = memoryview(self._source.data)[chunk.start : chunk.stop]
            plain = plain_bytes(chunk, packed, self._where, crc_needed=False, zstd=self._zstd)
            low, high = 1 << 64, -1
            for piece in self._inside(plain, chunk):
                first, last = self.tally.see(piece.heads["log"])
                low, high = min(low, first), max(high, last)
                yield piece
        except RecordingError as error:
            if not self._tolerant:
                raise
            self.end = error.what
            return
        self.tally.chunk(chunk, self._source.offset - chunk.offset)
        if high >= 0 and (low, high) != (chunk.first_ns, chunk.last_ns):
            self._problems.add("a chunk's header gives other times than its messages", chunk.offset, "odd")

    def _inside(self, plain: bytes, chunk: Chunk) -> Iterator[Piece]:
        """Walk the plain bytes of a chunk."""
        at, starts = 0, array("q")
        while at < len(plain):
            with reading(self._where, f"chunk at byte {chunk.offset}"):
                at = message_run(plain, at, starts)
                if len(starts) < PIECE and at < len(plain):
                    at = self._declaration(plain, at, chunk.offset)
            if len(starts) >= PIECE:
                yield Piece(plain, *heads(plain, starts))
        if starts:
            yield Piece(plain, *heads(plain, starts))

    def _declaration(self, plain: bytes, at: int, offset: int) -> int:
        """Take the record of a chunk that is no message; returns where it ends."""
        self._bounds.record(offset)
        if at + 9 > len(plain):
            raise ValueError(f"record at byte {at} of the unpacked chunk is cut off")
        op, size = struct.unpack_from("<BQ", plain, at)
        stop = at + 9 + size
        if stop > len(plain):
            raise ValueError(f"record at byte {at} of the unpacked chunk is cut off")
        if op == Op.SCHEMA:
            self._declared.schema(plain[at + 9 : stop], offset)
        elif op == Op.CHANNEL:
            self._declared.channel(plain[at + 9 : stop], offset)
        elif op >= PRIVATE:
            self._problems.add(f"unknown opcode {op} in a chunk; skipped", offset, "odd")
        elif op == Op.MESSAGE:
            raise ValueError(f"message of {size} B at byte {at} of the unpacked chunk")
        else:
            raise ValueError(f"record of type {op} at byte {at} of the unpacked chunk")
        return stop

    def _other(self, op: int, size: int) -> bool:
        """Take a record that is neither message nor chunk; False where the file ends within it."""
        source, offset = self._source, self._source.offset
        if op == Op.ATTACHMENT:
            return self._attachment(size)
        if op not in (Op.SCHEMA, Op.CHANNEL, Op.METADATA, Op.DATA_END):
            if op not in (Op.HEADER, Op.MESSAGE_INDEX) or (op == Op.HEADER) != (offset == len(MAGIC)):
                self._problems.add(f"record of type {op} in the data; skipped", offset, "odd")
            if op == Op.MESSAGE_INDEX and (not source.fill(15) or size < 6 or size != 6 + self._index_bytes()):
                self._problems.add("a message index is no such thing", offset, "damage")
            return source.skip(9 + size)
        if not source.fill(9 + size):
            return False
        if op == Op.DATA_END:
            self._data_end(size)
        content = source.data[source.at + 9 : source.at + 9 + size]
        source.at += 9 + size
        with reading(self._where, f"record at byte {offset}"):
            if op == Op.SCHEMA:
                self._declared.schema(content, offset)
                self._declared.outside += 1
            elif op == Op.CHANNEL:
                self._declared.channel(content, offset)
                self._declared.outside += 1
            elif op == Op.METADATA:
                self._add_metadata(content)
        return True

    def _index_bytes(self) -> int:
        """Length of the entries that the message index at the window's place claims."""
        return struct.unpack_from("<I", self._source.data, self._source.at + 11)[0]

    def _data_end(self, size: int) -> None:
        source = self._source
        offset, actual = source.offset, source.crc()
        with reading(self._where, f"end of data at byte {offset}"):
            (crc,) = struct.unpack_from("<I", source.data, source.at + 9)
            if size < 4:
                raise ValueError(f"{size} B")
        self.end = None
        if crc and crc != actual:
            raise refuse("data section: CRC mismatch; quarantined", self._where, DAMAGED)
        self.crc = crc

    def _add_metadata(self, content: bytes) -> None:
        name, at = text(content, 0, len(content))
        values, _ = pairs(content, at, len(content))
        self._metadata_bytes += len(content)
        if self._metadata_bytes > MAX_DECLARED:
            raise ValueError(f"metadata take more than {MAX_DECLARED} B")
        self.metadata.append((name, values))
        self.tally.metadata += 1

    def _attachment(self, size: int) -> bool:
        """Count an attachment; False where the file ends within it."""
        found = pass_attachment(self._source, size, self._where)
        if found is None:
            return False
        head, crc = found
        self.tally.attachments += 1
        self.tally.bare += not crc
        if len(self.attached) < MAX_NAMED:
            self.attached.append((head.name, head.stop - head.start))
        return True
