"""Decoding of other people's messages: one decoder a channel, chosen by how its messages are encoded."""

from collections.abc import Callable
from types import MappingProxyType
from typing import TYPE_CHECKING

from pipeline.errors import RecordingError
from pipeline.logs.fields import Decoder, Fields
from pipeline.logs.json_messages import JsonDecoder
from pipeline.logs.protobuf import ProtobufDecoder
from pipeline.logs.ros2 import Ros2Decoder

if TYPE_CHECKING:
    from pipeline.logs.batch import Channel

__all__ = ["ENCODINGS", "Decoder", "Fields", "decoder"]

ANY = "any"
"""Stands for every schema encoding, and for none."""

ENCODINGS: MappingProxyType[tuple[str, str], "Callable[[Channel], Decoder]"] = MappingProxyType({
    ("cdr", "ros2msg"): Ros2Decoder,
    ("cdr", "ros2idl"): Ros2Decoder,
    ("cdr", "omgidl"): Ros2Decoder,
    ("json", ANY): JsonDecoder,
    ("protobuf", "protobuf"): ProtobufDecoder,
})
"""(message encoding, schema encoding) -> decoder."""

_MEND = "leave the topic out of the map; it stays in the raw file"


def decoder(channel: "Channel") -> Decoder:
    """The decoder of a channel's messages.

    Raises:
        RecordingError: the encoding is not known, or the schema cannot be used; the caller counts the channel's
            messages and goes on.
    """
    kinds = (channel.encoding, channel.schema_encoding)
    make = ENCODINGS.get(kinds) or ENCODINGS.get((channel.encoding, ANY))
    if make is None:
        encoding, schema = (kind or "none" for kind in kinds)
        known = ", ".join(f"{a} with {b}" for a, b in ENCODINGS)
        raise RecordingError(f"messages are encoded as {encoding} with schema {schema}, known are {known}",
                             where=channel.topic, mend=_MEND)
    return make(channel)
