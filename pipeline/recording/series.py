"""Messages of a recording by topic, unpacked into arrays."""

import struct
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import RecordingError
from pipeline.recording.cdr import Layout
from pipeline.recording.dialect import MESSAGE_ENCODING
from pipeline.recording.errors import DAMAGED, SPLIT, reading, refuse
from pipeline.recording.fields import text
from pipeline.recording.records import MESSAGE_FIELDS, MESSAGE_HEAD, Op
from pipeline.recording.scan import MAX_TOTAL, Scan, unpack
from pipeline.trace import Rows

MAX_MESSAGES = 4_000_000
"""Above any episode; keeps a file of tiny messages from filling memory."""
LARGE = 4096
"""Size of a message that is not kept where nobody wants its topic: pictures [B]."""
_HEAD = np.dtype([("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"),
                  ("publish", "<u8")])
_PEEK = struct.Struct("<BQH")


@dataclass(frozen=True, slots=True)
class Series:
    """All messages of one topic, in the order they were written."""

    topic: str
    type: str
    where: Path
    data: bytes
    """Plain bytes of all chunks, one after another."""
    starts: NDArray[np.intp]
    """Where each message's record starts."""
    heads: NDArray[np.void]
    """Fields before the payloads."""

    def __len__(self) -> int:
        return len(self.starts)

    def ticks(self) -> NDArray[np.int64]:
        """Sequence numbers: the tick of every message."""
        return self.heads["sequence"].astype(np.int64)

    def payload(self, k: int) -> bytes:
        """Bytes of message k."""
        start = int(self.starts[k]) + MESSAGE_HEAD.size
        return self.data[start : start + int(self.heads["length"][k]) - MESSAGE_FIELDS]

    def floats(self, layout: Layout, count: int) -> list[Rows]:
        """Every run of float64 of the first `count` messages, (count, width) each; other bytes must be the layout's."""
        size = len(layout.template)
        lengths = self.heads["length"][:count]
        if (lengths != size + MESSAGE_FIELDS).any():
            k = int(np.argmax(lengths != size + MESSAGE_FIELDS))
            raise self.odd(k, f"has {int(lengths[k]) - MESSAGE_FIELDS} B, the others {size}")
        rows = _gather(self.data, self.starts[:count] + MESSAGE_HEAD.size, size)
        wrong = ((rows != np.frombuffer(layout.template, np.uint8)) & layout.fixed()).any(axis=1)
        if wrong.any():
            raise self.odd(int(np.argmax(wrong)), "is laid out otherwise")
        return [np.ascontiguousarray(rows[:, at : at + 8 * width]).view("<f8") for at, width in layout.floats]

    def odd(self, k: int, what: str) -> RecordingError:
        """The error for a message that does not look like the first of its topic."""
        return refuse(f"message {k} on {self.topic} {what}", self.where,
                      "record the topic with one layout throughout, or drop the episode")

    def check_order(self) -> None:
        """Raise RecordingError where time goes back."""
        back = np.flatnonzero(np.diff(self.heads["log"].astype(np.int64)) < 0)
        if back.size:
            k = int(back[0]) + 1
            seconds = (int(self.heads["log"][k - 1]) - int(self.heads["log"][k])) / 1e9
            raise refuse(f"{self.topic} goes back {seconds:.3g} s at message {k}", self.where,
                         "record with log_time from one monotonic clock, or drop the episode")


@dataclass(frozen=True, slots=True)
class Messages:
    """What the whole chunks of a file hold."""

    topics: dict[str, Series]
    total: int
    last_ns: int
    """Latest log time."""
    first_ns: int
    broken: RecordingError | None
    """Why the walk ended early, where that was allowed."""
    counts: dict[int, int]
    """Channel number -> messages."""


def collect(found: Scan, wanted: Callable[[str], bool], *, tolerant: bool) -> Messages:
    """Unpack the chunks and sort the messages of the wanted topics into Series.

    Args:
        found: the scanned file.
        wanted: which topics to index; the others are only counted, and large ones are not kept in memory.
        tolerant: stop at the first damaged chunk instead of raising.
    """
    walk = Walk(wanted)
    plains: list[bytes] = []
    base, broken = 0, None
    for chunk in found.chunks:
        try:
            plain = unpack(chunk, found)
            with reading(found.where, f"chunk at byte {chunk.offset}"):
                plain = walk.chunk(plain, base)
        except RecordingError as error:
            if not tolerant:
                raise
            broken = error
            break
        plains.append(plain)
        base += len(plain)
        if base > MAX_TOTAL:
            raise refuse(f"messages up to byte {chunk.stop} hold {base} B, limit {MAX_TOTAL}", found.where, SPLIT)
    walk.cut(base)
    data = plains[0] if len(plains) == 1 else b"".join(plains)
    return _sort(found, data, walk, wanted, broken)


def _sort(found: Scan, data: bytes, walk: "Walk", wanted: Callable[[str], bool],
          broken: RecordingError | None) -> Messages:
    topics: dict[str, Series] = {}
    first, last = walk.span
    for number, offsets in walk.starts.items():
        if number not in walk.channels:
            raise refuse(f"messages on channel {number}, which was never declared", found.where, DAMAGED)
        for at in (offsets[0], offsets[-1]):
            (stamp,) = struct.unpack_from("<Q", data, at + 15)
            first, last = min(first, stamp), max(last, stamp)
        topic, kind = walk.channels[number]
        if wanted(topic):
            if topic in topics:
                raise refuse(f"topic {topic} has two channels", found.where, "record every topic on one channel")
            places = np.array(offsets, np.intp)
            heads = _gather(data, places, _HEAD.itemsize).view(_HEAD)[:, 0]
            topics[topic] = Series(topic, kind, found.where, data, places, heads)
            topics[topic].check_order()
    counts = Counter({n: len(s) for n, s in walk.starts.items()}) + walk.left_out
    total = counts.total()
    return Messages(topics, total, last, first if total else 0, broken, dict(counts))


class Walk:
    """Goes through the records of chunks, one chunk after another, and notes what is where."""

    def __init__(self, wanted: Callable[[str], bool]) -> None:
        self.starts: defaultdict[int, list[int]] = defaultdict(list)
        """Channel -> where its messages start in what was kept of all chunks."""
        self.channels: dict[int, tuple[str, str]] = {}
        """Channel -> topic and type."""
        self.left_out: Counter[int] = Counter()
        """Channel -> messages that nobody wants and that were too large to keep."""
        self.span = (1 << 63, 0)
        """Earliest and latest log time of those [ns]."""
        self._schemas: dict[int, str] = {}
        self._wanted = wanted
        self._room = MAX_MESSAGES

    def chunk(self, plain: bytes, base: int) -> bytes:
        """Note every message, schema and channel; ValueError on what cannot be.

        Args:
            plain: the unpacked chunk.
            base: bytes that were kept of the chunks before it.

        Returns:
            What is kept of it: `plain` without large messages of topics that nobody wants.
        """
        at, end, peek, message = 0, len(plain), _PEEK.unpack_from, int(Op.MESSAGE)
        gone: list[tuple[int, int]] = []
        while at < end:
            op, size, number = peek(plain, at)
            stop = at + 9 + size
            self._room -= 1
            if self._room < 0:
                raise ValueError(f"more than {MAX_MESSAGES} messages")
            if stop > end:
                raise ValueError(f"record at byte {at} of the unpacked chunk is cut off")
            if op == message:
                if size < MESSAGE_FIELDS:
                    raise ValueError(f"message of {size} B at byte {at} of the unpacked chunk")
                if size > LARGE and number in self.channels and not self._wanted(self.channels[number][0]):
                    gone.append((at, stop))
                    base -= stop - at
                else:
                    self.starts[number].append(base + at)
            elif op == Op.SCHEMA:
                self._schemas[number] = text(plain, at + 11, stop)[0]
            elif op == Op.CHANNEL:
                self._declare(plain, number, at, stop)
            else:
                raise ValueError(f"record of type {op} at byte {at} of the unpacked chunk")
            at = stop
        return self._without(plain, gone) if gone else plain

    def cut(self, base: int) -> None:
        """Forget the messages from byte `base` on: their chunk turned out to be damaged."""
        for number, starts in list(self.starts.items()):
            self.starts[number] = [at for at in starts if at < base]
            if not self.starts[number]:
                del self.starts[number]

    def _declare(self, plain: bytes, number: int, at: int, stop: int) -> None:
        (schema,) = struct.unpack_from("<H", plain, at + 11)
        topic, after = text(plain, at + 13, stop)
        encoding, _ = text(plain, after, stop)
        if encoding != MESSAGE_ENCODING:
            raise ValueError(f"topic {topic} is encoded as {encoding!r}, not {MESSAGE_ENCODING!r}")
        self.channels[number] = (topic, self._schemas.get(schema, ""))

    def _without(self, plain: bytes, gone: list[tuple[int, int]]) -> bytes:
        first, last = self.span
        for at, _ in gone:
            number, _, stamp = struct.unpack_from("<HIQ", plain, at + 9)
            self.left_out[number] += 1
            first, last = min(first, stamp), max(last, stamp)
        self.span = (first, last)
        edges = [0, *(edge for span in gone for edge in span), len(plain)]
        return b"".join(plain[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True))


def _gather(data: bytes, starts: NDArray[np.intp], size: int) -> NDArray[np.uint8]:
    """Equal pieces of `data` as rows, shape (len(starts), size)."""
    windows = np.lib.stride_tricks.sliding_window_view(np.frombuffer(data, np.uint8), size)
    return windows[starts]
