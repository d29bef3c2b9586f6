"""What the topics of a log hold, by reading it once and decoding what is small: the ground of a first ingest map."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from pipeline.errors import RecordingError
from pipeline.logs.batch import Batch, Channel
from pipeline.logs.decode import Decoder, Fields, decoder
from pipeline.logs.stream import open_log
from schemas.base import Frozen

NS = 1_000_000_000
MAX_SMALL = 4096
"""Messages up to this size are all decoded, of larger ones only the first FEW [B]."""
FEW = 32
MAX_DECODED = 200_000
"""Messages of one channel that are decoded."""
MAX_STEPS = 500_000
"""Messages of one channel whose distances are looked at."""
PAUSE_S = 1.0
"""A shorter silence is no pause between two episodes [s]."""
_TOLD = 8
_LONGEST = 80
_MAGIC = {b"\xff\xd8\xff": "jpeg", b"\x89PN": "png", b"\x00\x00\x00": "video", b"\x00\x00\x01": "video"}


class NumbersSeen(Frozen):
    """A field of numbers."""

    widths: tuple[int, ...] = Field(description="values a message, every number of them that was seen")
    low: float | None = Field(description="smallest finite value")
    high: float | None
    integral: bool = Field(description="integers or truth values")


class StampsSeen(Frozen):
    """The stamps that messages carry themselves."""

    sane: bool = Field(description="set in nearly all messages, and they rise")
    behind_s: float = Field(description="log time minus stamp, median [s]")


class TopicSeen(Frozen):
    """One channel of a log."""

    topic: str
    type: str
    encoding: str
    messages: int
    bytes: int = Field(description="payloads together [B]")
    latched: int = Field(description="messages at log time 0, which no rate counts")
    first_ns: int
    last_ns: int
    rate_hz: float = Field(description="one over the median distance [Hz]; 0 for fewer than two messages")
    jitter_s: float = Field(description="95 % of the distances lie within this of the median [s]")
    pauses: tuple[float, ...] = Field(description="the longest silences over PAUSE_S and ten usual distances [s]")
    reason: str = Field(description="why it cannot be decoded, empty where it can")
    bad: int = Field(description="messages that could not be decoded")
    bad_reason: str
    numbers: dict[str, NumbersSeen]
    times: tuple[str, ...] = Field(description="those of the numbers that are times or durations [ns]")
    texts: dict[str, tuple[str, ...]] = Field(description="field -> the first different texts; one too many: more")
    names: dict[str, tuple[str, ...]] = Field(description="field of texts -> the sequence that most messages have")
    named: dict[str, int] = Field(description="field of texts -> different sequences")
    blobs: dict[str, str] = Field(description="field of bytes -> jpeg, png, video or empty")
    stamps: StampsSeen | None


class Survey(Frozen):
    """A log, topic by topic, by name."""

    topics: tuple[TopicSeen, ...]
    problems: tuple[str, ...]


def survey(log: str) -> dict[str, Any]:
    """Read a log to its end; made for a child process, so it takes a path as text and gives a Survey as JSON.

    Raises:
        RecordingError: damaged, hostile, cut off or not MCAP.
    """
    seen: dict[int, _Seen] = {}
    with open_log(Path(log)) as reader:
        for batch in reader.batches():
            seen.setdefault(batch.channel.number, _Seen(batch.channel)).feed(batch)
        for number, channel in reader.channels.items():
            seen.setdefault(number, _Seen(channel))
        problems = tuple(problem.what for problem in reader.problems)
    topics = sorted((entry.told() for entry in seen.values()), key=lambda t: (t.topic, t.type, t.encoding))
    return Survey(topics=tuple(topics), problems=problems).model_dump(mode="json")


@dataclass
class _Column:
    """What was seen of one field of numbers."""

    widths: Counter[int] = field(default_factory=Counter[int])
    low: float = np.inf
    high: float = -np.inf
    integral: bool = True


class _Seen:
    """One channel while the log is read."""

    def __init__(self, channel: Channel) -> None:
        self.channel, self.reason = channel, ""
        self.messages = self.bytes = self.latched = self.first = self.last = self.bad = self._decoded = 0
        self.bad_reason = ""
        self._steps: list[Any] = []
        self._kept = 0
        self.columns: dict[str, _Column] = {}
        self.texts: dict[str, dict[str, None]] = {}
        self.names: dict[str, Counter[tuple[str, ...]]] = {}
        self.blobs: dict[str, str] = {}
        self.times: set[str] = set()
        self._stamps, self._unset, self._behind = _Rising(), 0, list[Any]()
        try:
            self._decoder: Decoder | None = decoder(channel)
        except RecordingError as error:
            self._decoder, self.reason = None, error.what

    def feed(self, batch: Batch) -> None:
        """Look at one batch."""
        self.messages += len(batch)
        self.bytes += int(batch.sizes.sum())
        set_ns = batch.log_ns[batch.log_ns > 0]
        self.latched += len(batch) - len(set_ns)
        if len(set_ns):
            if self._kept < MAX_STEPS:
                before = [self.last] if self.last else []
                steps = np.diff(np.concatenate([np.array(before, np.int64), set_ns]))
                self._steps.append(steps / NS)
                self._kept += len(steps)
            self.first = min(self.first or int(set_ns.min()), int(set_ns.min()))
            self.last = int(set_ns[-1])
        large = self.bytes > MAX_SMALL * self.messages
        if self._decoder is not None and self._decoded < (FEW if large else MAX_DECODED):
            self._look(batch, self._decoder.decode(batch))

    def _look(self, batch: Batch, fields: Fields) -> None:
        self._decoded += len(batch)
        self.bad += len(fields.bad)
        if fields.bad and not self.bad_reason:
            self.bad_reason = fields.bad[0][1]
        for path, values in fields.values.items():
            self._number(path, values, [values.shape[1] if values.ndim == 2 else 1])
        for path, rows in fields.ragged.items():
            self._number(path, np.concatenate(rows), [len(row) for row in rows])
        for path, texts in fields.texts.items():
            known = self.texts.setdefault(path, {})
            for text in texts if len(known) <= _TOLD else ():
                known[text[:_LONGEST]] = None
        for path, names in fields.names.items():
            self.names.setdefault(path, Counter()).update(names)
        for path, blobs in fields.blobs.items():
            if not self.blobs.get(path) and blobs:
                self.blobs[path] = _MAGIC.get(bytes(blobs[0][:3]), "")
        self.times |= fields.times
        self._stamp(batch, fields)

    def _number(self, path: str, values: Any, widths: list[int]) -> None:
        column = self.columns.setdefault(path, _Column())
        column.widths.update(widths)
        column.integral &= values.dtype.kind in "iub"
        finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values
        if finite.size:
            column.low = min(column.low, float(finite.min()))
            column.high = max(column.high, float(finite.max()))

    def _stamp(self, batch: Batch, fields: Fields) -> None:
        stamps = fields.header_ns
        if stamps is None or not len(stamps):
            return
        self._unset += int((stamps <= 0).sum())
        self._stamps.feed(stamps)
        log = batch.log_ns[fields.rows]
        self._behind.append(((log - stamps) / NS)[(log > 0) & (stamps > 0)][:FEW])

    def told(self) -> TopicSeen:
        """What was seen."""
        steps = np.concatenate([np.zeros(0), *self._steps])
        usual = float(np.median(steps)) if steps.size else 0.0
        mean = (self.last - self.first) / NS / steps.size if steps.size else 0.0
        usual = usual if usual > 0 else mean  # several at one time: the median says nothing
        pauses = np.sort(steps[steps > max(PAUSE_S, 10 * usual)])[::-1] if usual > 0 else steps[:0]
        jitter = float(np.quantile(np.abs(steps - usual), 0.95)) if steps.size else 0.0
        numbers = {path: NumbersSeen(widths=tuple(sorted(c.widths)), low=c.low if np.isfinite(c.low) else None,
                                     high=c.high if np.isfinite(c.high) else None, integral=c.integral)
                   for path, c in self.columns.items()}
        return TopicSeen(
            topic=self.channel.topic, type=self.channel.schema_name, encoding=self.channel.encoding,
            messages=self.messages, bytes=self.bytes, latched=self.latched, first_ns=self.first, last_ns=self.last,
            rate_hz=1 / usual if usual > 0 else 0.0, jitter_s=jitter, pauses=tuple(map(float, pauses[:_TOLD])),
            reason=self.reason, bad=self.bad, bad_reason=self.bad_reason, numbers=numbers,
            times=tuple(sorted(self.times)), texts={p: tuple(t)[: _TOLD + 1] for p, t in self.texts.items()},
            names={p: c.most_common(1)[0][0] for p, c in self.names.items() if c},
            named={p: len(c) for p, c in self.names.items()}, blobs=self.blobs, stamps=self._stamps_seen())

    def _stamps_seen(self) -> StampsSeen | None:
        behind = np.concatenate([np.zeros(0), *self._behind])
        if not self._stamps.count:
            return None
        rare = self._stamps.count // 100
        sane = self._unset <= rare and self._stamps.back <= rare and behind.size > 0
        return StampsSeen(sane=sane, behind_s=float(np.median(behind)) if behind.size else 0.0)


class _Rising:
    """Counts stamps, and those that lie before the one before."""

    def __init__(self) -> None:
        self.count = self.back = 0
        self._last = np.iinfo(np.int64).min

    def feed(self, stamps: Any) -> None:
        """Look at some more."""
        self.back += int((stamps[1:] < stamps[:-1]).sum()) + int(stamps[0] < self._last)
        self.count, self._last = self.count + len(stamps), int(stamps[-1])
