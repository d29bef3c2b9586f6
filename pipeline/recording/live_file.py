"""The bytes of a live recording: messages are laid into an open chunk, chunks are sealed while time goes on."""

from array import array
from collections.abc import Iterable, Mapping

import zstandard

from pipeline.recording import records
from pipeline.recording.assemble import ZSTD_LEVEL, Assembly, add_extras, finish, seal_chunk
from pipeline.recording.dialect import (
    LIBRARY,
    MESSAGE_ENCODING,
    PROFILE,
    SCHEMA_ENCODING,
    definition,
    topic_type,
)
from pipeline.recording.records import MESSAGE_FIELDS, MESSAGE_HEAD, Op

CHUNK_BYTES = 1 << 20
"""Plain size at which a chunk is closed before its time [B]."""


class LiveFile:
    """Makes the bytes of one MCAP file in order; whoever holds it takes them with `take` and puts them on the disk.

    Metadata and attachments come first, so that a file cut short still says what it is. A topic is declared
    in the chunk of its first message.
    """

    def __init__(self, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes],
                 start_ns: int) -> None:
        self.assembly = Assembly()
        self.numbers: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
        self._extras = [len(metadata), len(attachments)]
        self._first_ns, self._last_ns = 0, 0
        self._open()
        self.assembly.add(records.MAGIC + records.header(PROFILE, LIBRARY))
        add_extras(self.assembly, metadata, attachments, start_ns)

    def _open(self) -> None:
        self._plain = bytearray()
        self._index: dict[int, array[int]] = {}
        self._span = (1 << 64, 0)

    @property
    def chunk_bytes(self) -> int:
        """Plain size of the chunk that is open [B]."""
        return len(self._plain)

    @property
    def messages(self) -> int:
        """Messages in sealed chunks."""
        return sum(self.assembly.counts.values())

    def declare(self, topic: str) -> int:
        """Number of a topic's channel; its schema and channel go before whatever comes next."""
        if topic in self.numbers:
            return self.numbers[topic]
        kind, file = topic_type(topic), self.assembly
        if kind not in self._schemas:
            self._schemas[kind] = len(self._schemas) + 1
            schema = records.schema(self._schemas[kind], kind, SCHEMA_ENCODING, definition(kind))
            file.mention(Op.SCHEMA, schema)
            self._plain += schema
        number = self.numbers[topic] = len(self.numbers) + 1
        channel = records.channel(number, self._schemas[kind], topic, MESSAGE_ENCODING)
        file.mention(Op.CHANNEL, channel)
        self._plain += channel
        return number

    def add(self, topic: str, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Lay one message into the open chunk."""
        number = self.declare(topic)
        self._note(number, log_ns, len(self._plain))
        head = MESSAGE_HEAD.pack(Op.MESSAGE, MESSAGE_FIELDS + len(payload), number, sequence, log_ns, publish_ns)
        self._plain += head
        self._plain += payload

    def add_block(self, block: bytes, places: Iterable[tuple[int, int]], log_ns: int) -> None:
        """Lay whole message records into the open chunk.

        Args:
            block: the records, of one log time.
            places: (channel, where its record starts in `block`).
            log_ns: that log time [ns].
        """
        base = len(self._plain)
        for number, at in places:
            self._note(number, log_ns, base + at)
        self._plain += block

    def _note(self, number: int, log_ns: int, at: int) -> None:
        entries = self._index.get(number)
        if entries is None:
            entries = self._index[number] = array("Q")
        entries.append(log_ns)
        entries.append(at)
        first, last = self._span
        self._span = (min(first, log_ns), max(last, log_ns))

    def seal(self) -> None:
        """Close the open chunk, if anything is in it."""
        if not self._index:
            return
        index, offsets = bytearray(), dict[int, int]()
        for number, entries in self._index.items():
            offsets[number] = len(index)
            data = entries.tobytes()
            index += records.record(Op.MESSAGE_INDEX, number.to_bytes(2, "little") + len(data).to_bytes(4, "little")
                                    + data)
            self.assembly.counts[number] = self.assembly.counts.get(number, 0) + len(entries) // 2
        self._first_ns = self._first_ns or self._span[0]
        self._last_ns = max(self._last_ns, self._span[1])
        seal_chunk(self.assembly, bytes(self._plain), self._span, bytes(index), offsets, self._compressor)
        self._open()

    def take(self) -> bytes:
        """The bytes that were made since the last call."""
        data = b"".join(self.assembly.pieces)
        self.assembly.pieces.clear()
        return data

    def end(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Seal what is open, write the last metadata, the summary and the footer."""
        self.seal()
        add_extras(self.assembly, metadata, {}, self._last_ns)
        finish(self.assembly, self.numbers, self._extras[0] + len(metadata), self._extras[1], self._first_ns,
               self._last_ns)
