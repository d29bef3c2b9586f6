"""Intake: what a map asks of one topic, taken from the stream and put down on the disk."""

from collections import Counter
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.logs.batch import Batch
from pipeline.logs.cameras import Images, ImageWriter
from pipeline.logs.episodes import Event
from pipeline.logs.fields import Fields
from pipeline.logs.mapping import EXAMPLE, Taker, said
from pipeline.logs.spool import Spool, Stamps
from schemas.conversion import CameraFile
from schemas.ingest import Camera, Clock, Marker, Source, TopicOutcome, Value

LATEST_NS = 1 << 62
"""Times from here on, in the year 2116, are no times [ns]."""


class Intake(Protocol):
    """Takes something from the messages of one topic."""

    topic: str
    refused: Counter[str]
    """Reason -> messages that were not used."""

    def feed(self, batch: Batch, fields: Fields) -> None:
        """Take what is wanted from one batch."""
        ...


def stamps(batch: Batch, fields: Fields, clock: Clock) -> Stamps | None:
    """Times of the decoded messages by a clock [ns], shape (n,); None where they have no stamp of their own."""
    if clock == "header":
        return fields.header_ns
    times = batch.log_ns if clock == "log" else batch.publish_ns
    return times if len(fields) == len(batch) else times[fields.rows]


class _Clocked:
    """The part of every intake that tells the time."""

    def __init__(self, topic: str, clock: Clock) -> None:
        self.topic, self.refused = topic, Counter[str]()
        self.clock: Clock = clock

    def _times(self, batch: Batch, fields: Fields) -> tuple[Stamps, NDArray[np.bool_]] | None:
        """Times and which of them can be times at all."""
        times = stamps(batch, fields, self.clock)
        if times is None:
            self.refused["no header stamp"] += len(fields)
            return None
        possible = (times >= 0) & (times < LATEST_NS)
        if not possible.all():
            self.refused[f"{self.clock} time is impossible"] += int((~possible).sum())
        return times, possible


class StateIntake(_Clocked):
    """The values of one source of a feature."""

    def __init__(self, feature: str, source: Source, clock: Clock, file: Path, robot: str) -> None:
        super().__init__(source.topic, source.clock or clock)
        self.feature, self.source, self._robot = feature, source, robot
        self.taker = Taker(source)
        self.refused = self.taker.refused
        self.spool: Spool | None = None
        self._file = file

    def feed(self, batch: Batch, fields: Fields) -> None:
        """See Intake."""
        if (timed := self._times(batch, fields)) is None:
            return
        times, possible = timed
        rows, values = self.taker.take(fields)
        if not rows.size:
            return
        if not possible.all():
            keep = possible[rows]
            rows, values = rows[keep], values[keep]
        if self.spool is None and rows.size:
            self._check_width(values.shape[1])
            self.spool = Spool(self._file, values.shape[1])
        if self.spool is None:
            return
        self.spool.append(times if rows.size == times.size else times[rows], self.taker.in_unit(values))

    def _check_width(self, width: int) -> None:
        """Refuse a map that speaks of more or fewer values than the messages have."""
        source = self.source
        if source.names and len(source.names) != width:
            raise ConfigError(f"{self.feature} has {width} values, robot {self._robot!r} expects {len(source.names)}",
                              where=self.topic, mend=f"name every value of {', '.join(source.fields)}; {EXAMPLE}")
        for field, given in (("scale", source.scale), ("offset", source.offset)):
            if isinstance(given, tuple) and len(given) != width:
                raise ConfigError(f"{self.feature}: {field} has {len(given)} entries for {width} values",
                                  where=self.topic, mend=EXAMPLE)


class EventIntake(_Clocked):
    """What a topic says, and when: markers and outcomes."""

    def __init__(self, wanted: Marker | TopicOutcome, clock: Clock) -> None:
        super().__init__(wanted.topic, wanted.clock or clock)
        self.wanted = wanted
        self.events: list[Event] = []
        self._field = wanted.field
        self._last: Value | None = None
        self._level = isinstance(wanted, Marker) and bool(wanted.stop)  # only a change says something new

    def feed(self, batch: Batch, fields: Fields) -> None:
        """See Intake."""
        if (timed := self._times(batch, fields)) is None:
            return
        times, possible = timed
        told = said(fields, self._field)
        if len(told) < len(fields):
            self.refused[f"no single value {self._field!r}"] += len(fields) - len(told)
        for row, value in told:
            if possible[row] and not (self._level and value == self._last):
                self.events.append((int(times[row]), value))
                self._last = value


class CameraIntake(_Clocked):
    """The images of one camera: bytes to a file of their own, numbers to a spool.

    Args:
        known: the file that an earlier conversion made of the same images, and what it said of it; nothing is
            taken from the log then.
    """

    def __init__(self, name: str, camera: Camera, clock: Clock, folder: Path,
                 known: tuple[Path, CameraFile] | None = None) -> None:
        super().__init__(camera.topic, camera.clock or clock)
        self.name, self.camera, self._known = name, camera, known
        self.spool = Spool(folder / f"spool.camera.{name}", 1)
        self.writer = ImageWriter(folder / f"camera.{name}") if known is None else None
        if known is not None:
            self.refused.update(known[1].left_out)
            stamps = Images(known[0]).stamps_ns()
            self.spool.append(stamps, np.arange(stamps.size, dtype=np.float64)[:, None])

    def close(self) -> CameraFile:
        """Finish the file and say what is in it."""
        if self.writer is None:
            assert self._known is not None
            return self._known[1]
        self.writer.close()
        return CameraFile(images=self.writer.images, format=self.writer.format or "unknown",
                          left_out=dict(sorted(self.refused.items())))

    def feed(self, batch: Batch, fields: Fields) -> None:
        """See Intake."""
        if self.writer is None or (timed := self._times(batch, fields)) is None:
            return
        times, possible = timed
        blobs = fields.blobs.get(self.camera.field)
        if blobs is None:
            self.refused[f"no bytes in field {self.camera.field!r}"] += len(fields)
            return
        there = np.array([len(blob) > 0 for blob in blobs], np.bool_)
        if not there.all():
            self.refused["empty image"] += int((~there).sum())
        rows = np.flatnonzero(possible & there)
        first = self.writer.images
        taken: list[int] = rows.tolist()
        for row, stamp in zip(taken, times[rows].tolist(), strict=True):
            self.writer.append(stamp, blobs[row])
        self.writer.format = self.writer.format or self._called(fields)
        self.spool.append(times[rows], np.arange(first, self.writer.images, dtype=np.float64)[:, None])

    def _called(self, fields: Fields) -> str:
        """How the messages call their format: `encoding` with the size of raw images, or `format`."""
        if texts := fields.texts.get("encoding") or fields.texts.get("format"):
            size = [int(fields.values[key][0]) for key in ("width", "height") if key in fields.values]
            return " ".join([texts[0], *(["x".join(map(str, size))] if size else [])])
        return ""
