"""A recording in memory, read and written by the mcap library, so that one thing in it can be changed."""

import io
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, DataEnd, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from pipeline.recording.metadata import NAME, SEAL, seal
from schemas.episode import Episode

type Rows = NDArray[np.float64]

CHUNK_BYTES = 64 << 10
"""As small as the recorder's own chunks, so that a damaged one takes a part of the recording only."""
_STAMP = struct.Struct("<iI")
_STAMP_AT = 4
"""Where the stamp stands in every message that begins with a std_msgs/Header: behind the CDR encapsulation [B]."""


@dataclass(slots=True)
class Log:
    """All that an MCAP file holds, in its order; messages may be changed, left out and added."""

    profile: str
    schemas: dict[int, Schema] = field(default_factory=dict[int, Schema])
    channels: dict[int, Channel] = field(default_factory=dict[int, Channel])
    head: list[Metadata | Attachment] = field(default_factory=list[Metadata | Attachment])
    """Before the first message."""
    messages: list[Message] = field(default_factory=list[Message])
    tail: list[Metadata | Attachment] = field(default_factory=list[Metadata | Attachment])
    """After the last message."""

    @classmethod
    def read(cls, path: Path) -> "Log":
        """Every record of a file's data section."""
        log = cls("")
        for record in StreamReader(io.BytesIO(path.read_bytes())).records:
            match record:
                case Header():
                    log.profile = record.profile
                case Schema():
                    log.schemas[record.id] = record
                case Channel():
                    log.channels[record.id] = record
                case Message():
                    log.messages.append(record)
                case Metadata() | Attachment():
                    (log.tail if log.messages else log.head).append(record)
                case DataEnd():
                    break
                case _:
                    pass
        return log

    def write(self, path: Path) -> None:
        """Write the file anew, with every CRC and a true summary."""
        with path.open("wb") as stream:
            writer = Writer(stream, chunk_size=CHUNK_BYTES, enable_data_crcs=True)
            writer.start(self.profile, "somebody else's recorder")
            schemas = {n: writer.register_schema(s.name, s.encoding, s.data) for n, s in self.schemas.items()}
            channels = {n: writer.register_channel(c.topic, c.message_encoding, schemas[c.schema_id], c.metadata)
                        for n, c in self.channels.items()}
            _add(writer, self.head)
            for m in self.messages:
                writer.add_message(channels[m.channel_id], m.log_time, m.data, m.publish_time, m.sequence)
            _add(writer, self.tail)
            writer.finish()

    def topic(self, message: Message) -> str:
        """The topic of a message."""
        return self.channels[message.channel_id].topic

    def of(self, topic: str) -> list[Message]:
        """The messages of one topic, in order; changing them changes the log."""
        return [m for m in self.messages if self.topic(m) == topic]

    def drop(self, unwanted: Callable[[Message], bool]) -> None:
        """Leave messages out."""
        self.messages = [m for m in self.messages if not unwanted(m)]

    @property
    def start_ns(self) -> int:
        """Log time of the first message [ns]."""
        return min(m.log_time for m in self.messages)

    @property
    def span_s(self) -> float:
        """From the first message to the last one [s]."""
        return (max(m.log_time for m in self.messages) - self.start_ns) / 1e9

    def at_s(self, message: Message) -> float:
        """Log time from the first message [s]."""
        return (message.log_time - self.start_ns) / 1e9

    def numbers(self, topic: str, part: str) -> Rows:
        """A field of float64 in every message of a topic, shape (messages, values)."""
        decode = self._decoder(topic)
        return np.array([getattr(decode(m.data), part) for m in self.of(topic)], np.float64)

    def put(self, topic: str, part: str, rows: Rows) -> None:
        """Change a field of float64 in every message of a topic; everything else of the message stays as it is."""
        for message, before, after in zip(self.of(topic), self.numbers(topic, part), rows, strict=True):
            packed = before.astype("<f8").tobytes()
            last = len(message.data) - len(packed)  # looked at first: zeros are found wherever a message has some
            at = last if message.data.endswith(packed) else message.data.index(packed)
            message.data = message.data[:at] + after.astype("<f8").tobytes() + message.data[at + len(packed):]

    def names(self, topic: str) -> list[str]:
        """Names of the values, as the topic's first message gives them (JointState)."""
        return list(self._decoder(topic)(self.of(topic)[0].data).name)

    def stamp(self, message: Message, stamp_ns: int) -> None:
        """Say that a message was measured at another time: header, if it has one, and publish time."""
        message.publish_time = stamp_ns
        if self.has_header(message):
            packed = _STAMP.pack(*divmod(stamp_ns, 1_000_000_000))
            message.data = message.data[:_STAMP_AT] + packed + message.data[_STAMP_AT + _STAMP.size:]

    def has_header(self, message: Message) -> bool:
        """Whether the message's own fields begin with a std_msgs/Header."""
        schema = self.schemas[self.channels[message.channel_id].schema_id]
        return schema.data.decode().lstrip().startswith("std_msgs/Header")

    def attachment(self, name: str) -> bytes:
        """The content of an attached file; KeyError where there is none."""
        for record in (*self.head, *self.tail):
            if isinstance(record, Attachment) and record.name == name:
                return record.data
        raise KeyError(name)

    @property
    def episode(self) -> Episode:
        """What the recording says of itself at its end."""
        return Episode.model_validate_json(self._record().metadata["episode_json"])

    def tell(self, episode: Episode, **strings: str) -> None:
        """Let the recording say something else of itself: another Episode, other strings, under a seal that fits."""
        record = self._record()
        told = {"episode": episode.id, "origin": episode.origin, "outcome": episode.outcome.label,
                "frames": str(episode.frames), "consent": episode.consent, **strings,
                "episode_json": episode.model_copy(update={"blob": None}).model_dump_json()}
        values = {**record.metadata, **told}
        values[SEAL] = seal(values)
        record.metadata = values

    def _record(self) -> Metadata:
        return next(r for r in (*self.tail, *self.head) if isinstance(r, Metadata) and r.name == NAME)

    def _decoder(self, topic: str) -> Callable[[bytes], Any]:
        channel = next(c for c in self.channels.values() if c.topic == topic)
        decode = DecoderFactory().decoder_for(channel.message_encoding, self.schemas[channel.schema_id])
        if decode is None:
            raise ValueError(f"{topic} is no ROS 2 topic")
        return decode


def copy_of(message: Message, **changes: int) -> Message:
    """A message once more, with other times or another number."""
    return replace(message, **changes)


def _add(writer: Writer, records: Iterable[Metadata | Attachment]) -> None:
    for record in records:
        if isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        else:
            writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
