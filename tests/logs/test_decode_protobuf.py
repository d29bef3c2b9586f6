"""Protobuf messages, their types out of the log's own descriptors."""

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, timestamp_pb2
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import RecordingError
from pipeline.logs.decode import decoder

F = descriptor_pb2.FieldDescriptorProto


def described(types, *, complete=True):
    """A FileDescriptorSet of package p: type -> [(name, protobuf type or type name, repeated)]."""
    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="p.proto", package="p", syntax="proto3", dependency=["google/protobuf/timestamp.proto"])
    for name, fields in types.items():
        message = file.message_type.add(name=name)
        for number, (field, kind, repeated) in enumerate(fields, 1):
            made = message.field.add(name=field, number=number, label=3 if repeated else 1)
            made.type = F.TYPE_MESSAGE if isinstance(kind, str) else kind
            if isinstance(kind, str):
                made.type_name = kind
    if complete:
        timestamp_pb2.DESCRIPTOR.CopyToProto(files.file.add())
    return files


def class_of(files, name):
    pool = DescriptorPool()
    for file in reversed(files.file):
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(name))


ARM = {
    "Arm": [("timestamp", ".google.protobuf.Timestamp", False), ("q", F.TYPE_DOUBLE, True),
            ("names", F.TYPE_STRING, True), ("mode", F.TYPE_INT32, False), ("tool", ".p.Pose", False),
            ("path", ".p.Pose", True), ("parent", ".p.Arm", False)],
    "Pose": [("x", F.TYPE_FLOAT, False), ("label", F.TYPE_STRING, False), ("raw", F.TYPE_BYTES, False),
             ("at", ".google.protobuf.Timestamp", False)],
}


def arm(made, k, points=2):
    message = made(q=[k, 0.5], names=["a", "b"], mode=-k)
    message.timestamp.seconds, message.timestamp.nanos = k, 3
    message.tool.x = k
    for n in range(points):
        message.path.add(x=n, label=f"p{n}", raw=bytes([k, n]))
    return message.SerializeToString()


def test_fields_become_columns_by_their_path(channel_of, batch_of):
    files = described(ARM)
    channel = channel_of("p.Arm", files.SerializeToString(), "protobuf", "protobuf")
    fields = decoder(channel).decode(batch_of(channel, [arm(class_of(files, "p.Arm"), k) for k in range(3)]))
    assert fields.header_ns.tolist() == [3, 10**9 + 3, 2 * 10**9 + 3]
    assert fields.values["q"].tolist() == [[0.0, 0.5], [1.0, 0.5], [2.0, 0.5]]
    assert fields.values["mode"].tolist() == [0, -1, -2]
    assert fields.values["tool.x"].dtype == np.float32
    assert fields.values["path.x"].tolist() == [[0.0, 1.0]] * 3
    assert fields.names["names"] == [("a", "b")] * 3
    assert fields.names["path.label"] == [("p0", "p1")] * 3
    assert bytes(fields.blobs["path.raw"][2]) == bytes([2, 0, 2, 1])
    assert not any(path.startswith("parent.parent") for path in fields.values)


def test_sequences_that_change_their_length_are_kept_message_by_message(channel_of, batch_of):
    files = described(ARM)
    channel = channel_of("p.Arm", files.SerializeToString(), "protobuf", "protobuf")
    made = class_of(files, "p.Arm")
    fields = decoder(channel).decode(batch_of(channel, [arm(made, 1, points=n) for n in (0, 2, 1)]))
    assert [row.tolist() for row in fields.ragged["path.x"]] == [[], [0.0, 1.0], [0.0]]


def test_a_picture_and_a_map_are_read(channel_of, batch_of):
    files = described({"Picture": [("timestamp", ".google.protobuf.Timestamp", False), ("data", F.TYPE_BYTES, False),
                                   ("format", F.TYPE_STRING, False), ("tags", ".p.Picture.TagsEntry", True)]})
    entry = files.file[0].message_type[0].nested_type.add(name="TagsEntry")
    entry.options.map_entry = True
    entry.field.add(name="key", number=1, type=F.TYPE_STRING, label=1)
    entry.field.add(name="value", number=2, type=F.TYPE_DOUBLE, label=1)
    made = class_of(files, "p.Picture")
    payloads = [made(data=b"\xff\xd8", format="jpeg", tags={"b": 2.0, "a": 1.0}).SerializeToString()] * 2
    channel = channel_of("p.Picture", files.SerializeToString(), "protobuf", "protobuf")
    fields = decoder(channel).decode(batch_of(channel, payloads))
    assert [bytes(blob) for blob in fields.blobs["data"]] == [b"\xff\xd8"] * 2
    assert fields.names["tags.key"] == [("a", "b")] * 2
    assert fields.values["tags.value"].tolist() == [[1.0, 2.0]] * 2


def test_times_may_be_missing_from_the_descriptors(channel_of, batch_of):
    files = described({"T": [("timestamp", ".google.protobuf.Timestamp", False)]}, complete=False)
    channel = channel_of("p.T", files.SerializeToString(), "protobuf", "protobuf")
    assert decoder(channel).decode(batch_of(channel, [b""])).header_ns.tolist() == [0]


def test_messages_that_cannot_be_are_named_and_the_others_go_on(channel_of, batch_of):
    files = described(ARM)
    channel = channel_of("p.Arm", files.SerializeToString(), "protobuf", "protobuf")
    made = class_of(files, "p.Arm")
    late = made()
    late.timestamp.seconds = 2**62
    payloads = [arm(made, 1), b"\x0a\xff\xff\xff\xff\x07", late.SerializeToString(), arm(made, 2)]
    fields = decoder(channel).decode(batch_of(channel, payloads))
    assert fields.rows.tolist() == [0, 3]
    assert fields.values["mode"].tolist() == [-1, -2]
    assert [row for row, _ in fields.bad] == [1, 2]
    assert "is no p.Arm" in fields.bad[0][1]


def exponential():
    types = {f"T{k}": [("a", f".p.T{k + 1}", k % 2 == 0), ("b", f".p.T{k + 1}", False)] for k in range(30)}
    return described({**types, "T30": []}).SerializeToString()


def circular():
    files = described({"T0": []})
    files.file[0].dependency.append("q.proto")
    files.file.add(name="q.proto", dependency=["p.proto"])
    return files.SerializeToString()


def odd_map():
    files = described({"T0": [("tags", ".p.T0.TagsEntry", True)]})
    entry = files.file[0].message_type[0].nested_type.add(name="TagsEntry")
    entry.options.map_entry = True
    entry.field.add(name="kuy", number=1, type=F.TYPE_STRING, label=1)
    entry.field.add(name="value", number=2, type=F.TYPE_DOUBLE, label=1)
    return files.SerializeToString()


@pytest.mark.parametrize(("schema", "reason"), [
    (b"\xff\xff\xff", "cannot be used"),
    (b"", "cannot be used"),
    (described({"Other": []}).SerializeToString(), "cannot be used"),
    (described({"T0": [("x", ".p.Gone", False)]}).SerializeToString(), "cannot be used"),
    (circular(), "imports itself"),
    (exponential(), "more than 4096 fields"),
    (odd_map(), "map without key and value"),
], ids=["garbage", "empty", "other type", "missing type", "circular", "exponential", "odd map"])
def test_a_hostile_descriptor_is_refused_with_a_mend(schema, reason, channel_of):
    with pytest.raises(RecordingError, match=rf"(?s){reason}.*at: +/topic.*mend: .*out of the map"):
        decoder(channel_of("p.T0", schema, "protobuf", "protobuf"))


@settings(max_examples=40)
@given(rows=st.lists(st.tuples(st.integers(-(2**31), 2**31 - 1), st.lists(st.floats(width=32, allow_nan=False)),
                               st.text(max_size=4), st.binary(max_size=4)), min_size=1, max_size=6))
def test_whatever_protobuf_writes_is_read(rows, channel_of, batch_of):
    files = described({"T": [("i", F.TYPE_SINT32, False), ("v", F.TYPE_FLOAT, True), ("s", F.TYPE_STRING, False),
                             ("b", F.TYPE_BYTES, False)]})
    made = class_of(files, "p.T")
    channel = channel_of("p.T", files.SerializeToString(), "protobuf", "protobuf")
    payloads = [made(i=i, v=v, s=s, b=b).SerializeToString() for i, v, s, b in rows]
    fields = decoder(channel).decode(batch_of(channel, payloads))
    floats = fields.values.get("v", fields.ragged.get("v"))
    found = zip(fields.values["i"].tolist(), [row.tolist() for row in floats], fields.texts["s"],
                map(bytes, fields.blobs["b"]), strict=True)
    assert list(found) == rows
