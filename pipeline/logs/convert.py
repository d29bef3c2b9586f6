"""Conversion: a foreign log and a map become episodes on an even clock. The log is read once, in a stream.

What is taken goes to spools on the disk as it comes; then the episodes are laid out one after the other.
"""

import time
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import Any

from pipeline.errors import ConfigError, RecordingError, StoreError
from pipeline.logs.batch import Channel
from pipeline.logs.decode import Decoder, decoder
from pipeline.logs.framing import Framing
from pipeline.logs.intake import CameraIntake, EventIntake, Intake, StateIntake
from pipeline.logs.mapping import EXAMPLE
from pipeline.logs.stream import LogReader, open_log
from pipeline.logs.tracks import tracks
from schemas.conversion import CameraFile, TopicUse
from schemas.ingest import IngestMap, Marker, TopicOutcome

FRAMES = "frames"
"""The file of frames; the images of a camera lie beside it in a file of their own, CAMERA and its name."""
CAMERA = "camera."
PROGRESS = "progress"
"""A file that says how many bytes of the log were read so far."""
PROGRESS_S = 0.5

_LISTED = 20


def convert(log: str, declared: str, folder: str, accept_truncated: bool = False,
            known: dict[str, tuple[str, dict[str, Any]]] | None = None) -> dict[str, Any]:
    """Convert one log; made for a child process, so it takes texts and gives what JSON knows.

    Args:
        log: path of an MCAP file.
        declared: an IngestMap as JSON; its labels play no part.
        folder: an empty folder; gets `frames` and one `camera.NAME` for each camera that is not known.
        accept_truncated: keep what comes before the first damage or missing byte.
        known: camera -> file and CameraFile that an earlier conversion of this log made of the same images.

    Returns:
        A Converted.

    Raises:
        RecordingError: the log is damaged or hostile.
        ConfigError: the map and the log do not fit; a topic that is missing is one case.
        StoreError: the disk is full, or refuses.
    """
    try:
        asked, there = IngestMap.model_validate_json(declared), {
            name: (Path(file), CameraFile.model_validate(told)) for name, (file, told) in (known or {}).items()}
        return _convert(Path(log), asked, Path(folder), accept_truncated, there)
    except OSError as error:
        raise StoreError(f"the conversion cannot be written: {error.strerror or error}", where=folder,
                         mend="free some space (hardcase gc shows what can go), then ingest again") from error


def _convert(log: Path, asked: IngestMap, into: Path, accept_truncated: bool,
             known: Mapping[str, tuple[Path, CameraFile]]) -> dict[str, Any]:
    reading = _Reading(asked, into, known)
    with open_log(log, accept_truncated=accept_truncated) as reader:
        reading.run(reader)
        topics, problems = reading.topics(reader), [p.what for p in reader.problems]
    cameras = {camera.name: camera.close() for camera in reading.cameras}
    reading.require(log, topics)
    taken = tracks(reading.states, reading.cameras, log, problems)
    result = Framing(asked, taken, reading.events, log, problems).write(into / FRAMES)
    for spool in into.glob("spool.*"):
        spool.unlink()
    told = result.model_copy(update={"topics": topics, "problems": tuple(problems), "cameras": cameras})
    return told.model_dump(mode="json")


class _Reading:
    """One pass over a log: every batch is decoded once and handed to all that want something of its topic."""

    def __init__(self, asked: IngestMap, folder: Path, known: Mapping[str, tuple[Path, CameraFile]]) -> None:
        sources = [(name, source) for name, many in asked.features.items() for source in many]
        self.states = [StateIntake(name, source, asked.clock, folder / f"spool.{k}", asked.robot)
                       for k, (name, source) in enumerate(sources)]
        self.cameras = [CameraIntake(name, camera, asked.clock, folder, known.get(name))
                        for name, camera in asked.cameras.items()]
        told = (asked.episodes, asked.outcome)
        self.events = [EventIntake(w, asked.clock) for w in told if isinstance(w, Marker | TopicOutcome)]
        self._asked, self._progress = asked, folder / PROGRESS
        self._by_topic: dict[str, list[Intake]] = {}
        for intake in chain[Intake](self.states, self.cameras, self.events):
            self._by_topic.setdefault(intake.topic, []).append(intake)
        self._decoders: dict[int, Decoder | RecordingError] = {}
        self._bad: dict[int, tuple[int, str]] = {}

    def run(self, reader: LogReader) -> None:
        """Read the log to its end."""
        told = 0.0
        for batch in reader.batches(self._wanted):
            if (now := time.monotonic()) > told + PROGRESS_S:
                self._progress.write_text(str(reader.position), encoding="ascii")
                told = now
            number = batch.channel.number
            decode = self._decoders[number]
            assert not isinstance(decode, RecordingError), "no batches are asked for of what cannot be decoded"
            fields = decode.decode(batch)
            if fields.bad:
                count, reason = self._bad.get(number, (0, fields.bad[0][1]))
                self._bad[number] = count + len(fields.bad), reason
            if len(fields):
                for intake in self._by_topic[batch.channel.topic]:
                    intake.feed(batch, fields)

    def topics(self, reader: LogReader) -> tuple[TopicUse, ...]:
        """What became of every topic, in the order of their names."""
        return tuple(self._use(reader, channel) for channel in
                     sorted(reader.channels.values(), key=lambda c: (c.topic, c.number)))

    def require(self, log: Path, topics: tuple[TopicUse, ...]) -> None:
        """Refuse a log without a sample of something that makes its frames."""
        there = {use.topic: use for use in topics}
        for intake in (*self.states, *self.cameras, *(e for e in self.events if isinstance(e.wanted, Marker))):
            use = there.get(intake.topic)
            if use is None or not use.messages:
                names = ", ".join(sorted(there)[:_LISTED]) or "nothing"
                raise ConfigError(f"topic {intake.topic}, required by map {self._asked.name!r}, is missing",
                                     where=log, mend=f"name topics as the log does; it holds: {names}")
            if use.use == "undecodable":
                raise ConfigError(f"topic {intake.topic}, required by map {self._asked.name!r}, cannot be decoded: "
                                     f"{use.reason}", where=log, mend="leave it out of the map; the log stays as it is")
            if isinstance(intake, StateIntake) and intake.spool is None:
                raise _no_values(intake, use, log)

    def _wanted(self, channel: Channel) -> bool:
        try:
            self._decoders[channel.number] = decoder(channel)
        except RecordingError as error:
            self._decoders[channel.number] = error
            return False
        takers = self._by_topic.get(channel.topic, ())
        return any(not isinstance(taker, CameraIntake) or taker.writer is not None for taker in takers)

    def _use(self, reader: LogReader, channel: Channel) -> TopicUse:
        intakes = self._by_topic.get(channel.topic, [])
        decode = self._decoders.get(channel.number)
        left_out = {reason: n for intake in intakes for reason, n in sorted(intake.refused.items())}
        if number := self._bad.get(channel.number):
            left_out[f"cannot be decoded, the first: {number[1]}"] = number[0]
        failed = decode.what if isinstance(decode, RecordingError) else ""
        use = "undecodable" if failed else "used" if intakes else "unused"
        return TopicUse(topic=channel.topic, type=channel.schema_name, encoding=channel.encoding,
                        messages=reader.counts.get(channel.number, 0), use=use, reason=failed, left_out=left_out)


def _no_values(intake: StateIntake, use: TopicUse, log: Path) -> ConfigError:
    most = sorted(use.left_out.items(), key=lambda item: -item[1])[:3]
    reasons = "; ".join(f"{reason} ({n} messages)" for reason, n in most)
    fields = ", ".join(sorted(intake.taker.seen)[:_LISTED])
    mend = f"its number fields are: {fields}" if fields else EXAMPLE
    return ConfigError(f"{intake.feature}: no message of {intake.topic} has the values asked for: {reasons}",
                          where=log, mend=mend)
