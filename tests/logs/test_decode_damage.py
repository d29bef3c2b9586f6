"""Damaged schemas and payloads of every encoding: refused or named, and every message is accounted for."""

import json

import pytest
from google.protobuf import descriptor_pb2
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import RecordingError
from pipeline.logs.decode import decoder

MSG = b"""string[] names
float64[] position
T2[2] pair  # twice
uint8[] picture
================================================================================
MSG: p/T2
builtin_interfaces/Time stamp
wstring<=5 label "hey"
"""
IDL = b"""module p { module msg { typedef double d[3]; @verbatim(text="x" "y") struct T {
  d position; sequence<string<5>, 3> names; sequence<octet> picture; @unit(value="m") long long ticks; }; }; };"""
CDR = b"\x00\x01\x00\x00" + b"\x01\x00\x00\x00\x02\x00\x00\x00a\x00" + bytes(90)


def descriptors() -> bytes:
    files = descriptor_pb2.FileDescriptorSet()
    message = files.file.add(name="p.proto", package="p").message_type.add(name="T")
    for number, (name, kind) in enumerate({"names": 9, "position": 1, "picture": 12}.items(), 1):
        message.field.add(name=name, number=number, type=kind, label=3)
    return files.SerializeToString()


LOGS = {
    "ros2msg": ("p/msg/T", "cdr", MSG, CDR),
    "ros2idl": ("p/msg/T", "cdr", IDL, CDR),
    "protobuf": ("p.T", "protobuf", descriptors(), b"\x0a\x01a\x12\x08" + bytes(8) + b"\x1a\x02\xff\xd8"),
    "jsonschema": ("T", "json", b'{"properties": {"picture": {"contentEncoding": "base64"}}}',
                   json.dumps({"names": ["a"], "position": [0.5], "picture": "/9g=", "stamp": {"sec": 1, "nsec": 2}})
                   .encode()),
}
cuts = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 8), st.binary(max_size=4)), max_size=3)


def changed(data: bytes, edits: list[tuple[int, int, bytes]]) -> bytes:
    for at, length, new in edits:
        place = at % (len(data) + 1)
        data = data[:place] + new + data[place + length :]
    return data


@pytest.mark.parametrize("kind", LOGS)
@settings(max_examples=80, deadline=None)
@given(schema=cuts, payload=cuts)
def test_damage_is_refused_or_named_and_nothing_is_lost(kind, schema, payload, channel_of, batch_of):
    name, encoding, definition, whole = LOGS[kind]
    channel = channel_of(name, changed(definition, schema), encoding, kind)
    payloads = [whole, changed(whole, payload), whole]
    try:
        fields = decoder(channel).decode(batch_of(channel, payloads))
    except RecordingError as error:
        assert schema, "a whole schema is not refused"
        assert "out of the map" in str(error)
        return
    assert sorted([*fields.rows.tolist(), *(row for row, _ in fields.bad)]) == [0, 1, 2]
    for columns in (fields.values, fields.ragged, fields.texts, fields.names, fields.blobs):
        assert {len(column) for column in columns.values()} <= {len(fields)}
