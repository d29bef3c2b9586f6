"""ROS 2 messages as other people's recorders write them, odd and hostile ones too."""

import struct
import tracemalloc
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2.writer import Writer

from pipeline.errors import RecordingError
from pipeline.logs.decode import decoder
from pipeline.logs.stream import open_log
from pipeline.recording.cdr import joint_state, text

LOGS = Path(__file__).parents[3] / "shared/logs"

SEPARATOR = "=" * 80
HEADER = f"{SEPARATOR}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
JOINT_STATE = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{HEADER}"""


def joints(names: list[str], k: int) -> bytes:
    """A JointState of our own recorder, stamped k seconds; joint i stands at 10 k + i."""
    layout = joint_state(names, velocity=False, effort=False)
    payload = bytearray(layout.template)
    struct.pack_into("<iI", payload, layout.stamps[0], k, 5)
    at, count = layout.floats[0]
    struct.pack_into(f"<{count}d", payload, at, *(10.0 * k + i for i in range(count)))
    return bytes(payload)


def test_a_topic_of_two_nodes_is_read_in_the_order_of_its_messages(channel_of, batch_of):
    channel = channel_of("sensor_msgs/msg/JointState", JOINT_STATE)
    payloads = [joints(["a", "b"], k) if k % 3 else joints(["grip"], k) for k in range(7)]
    fields = decoder(channel).decode(batch_of(channel, payloads))
    assert [len(row) for row in fields.ragged["position"]] == [1, 2, 2, 1, 2, 2, 1]
    assert fields.ragged["position"][4].tolist() == [40.0, 41.0]
    assert fields.names["name"][3:5] == [("grip",), ("a", "b")]
    assert fields.header_ns.tolist() == [k * 10**9 + 5 for k in range(7)]
    assert fields.values["velocity"].shape == (7, 0)


def test_texts_may_change_while_their_lengths_stay(channel_of, batch_of):
    channel = channel_of("sensor_msgs/msg/JointState", JOINT_STATE)
    payloads = [joints(["left", name], 1) for name in ("right", "wrist", "right")]
    fields = decoder(channel).decode(batch_of(channel, payloads))
    assert fields.names["name"] == [("left", "right"), ("left", "wrist"), ("left", "right")]
    assert fields.values["position"].tolist() == [[10.0, 11.0]] * 3


def test_messages_of_ever_other_lengths_are_read_one_by_one(channel_of, batch_of):
    channel = channel_of("p/msg/T", "string a\nfloat64 x\nuint8[] picture\nstring[] words\nint32[] n")
    payloads, expected = [], []
    for k in range(20):
        body = text("w" * k)[4:]
        body += bytes(-len(body) % 8) + struct.pack("<dI", k, k) + bytes(range(k))
        body += bytes(-len(body) % 4) + struct.pack("<I", 0) + struct.pack(f"<I{k}i", k, *range(k))
        payloads.append(b"\x00\x01\x00\x00" + body)
        expected.append(("w" * k, float(k), bytes(range(k)), (), list(range(k))))
    fields = decoder(channel).decode(batch_of(channel, payloads))
    found = zip(fields.texts["a"], fields.values["x"].tolist(), map(bytes, fields.blobs["picture"]),
                fields.names["words"], [row.tolist() for row in fields.ragged["n"]], strict=True)
    assert list(found) == expected


def test_images_of_changing_size_are_views_of_the_chunk(channel_of, batch_of):
    schema = f"std_msgs/Header header\nstring format\nuint8[] data\n{HEADER}"
    channel = channel_of("sensor_msgs/CompressedImage", schema)
    pictures = [bytes([k]) * (1000 + k) for k in range(30)]
    payloads = [b"\x00\x01\x00\x00" + struct.pack("<iII", k, 0, 4) + b"cam\0" + struct.pack("<I", 5) + b"jpeg\0\0\0\0"
                + struct.pack("<I", len(picture)) + picture for k, picture in enumerate(pictures)]
    batch = batch_of(channel, payloads)
    fields = decoder(channel).decode(batch)
    assert [bytes(blob) for blob in fields.blobs["data"]] == pictures
    assert all(blob.obj is batch.data for blob in fields.blobs["data"])
    assert fields.texts["format"] == ["jpeg"] * 30


def test_counts_behind_a_picture_are_looked_at_too(channel_of, batch_of):
    channel = channel_of("p/msg/T", "uint8[] picture\nuint8[] mask\nstring[] s\nint32 x")
    payloads = [b"\x00\x01\x00\x00" + struct.pack("<I4sI4sIi", 4, b"data", size, b"mask", 0, 7) for size in (1, 3, 4)]
    fields = decoder(channel).decode(batch_of(channel, payloads))
    assert [bytes(blob) for blob in fields.blobs["mask"]] == [b"m", b"mas", b"mask"]
    assert fields.values["x"].tolist() == [7, 7, 7]


@pytest.mark.parametrize(("payload", "reason"), [
    (b"", "nothing"),
    (b"\x00\x03\x00\x00" + bytes(8), "PL_CDR"),
    (b"\x00\x07\x00\x00" + bytes(8), "CDR2"),
    (b"\x00\x01\x00\x00" + struct.pack("<I", 0xFFFFFFFF), "do not fit"),
    (b"\x00\x01\x00\x00" + struct.pack("<I", 2) + b"ab" + bytes(6), "closing zero"),
    (b"\x00\x01\x00\x00" + struct.pack("<I", 2) + b"\xff\0\0\0" + bytes(4), "utf-8"),
    (b"\x00\x01\x00\x00" + struct.pack("<I", 2) + b"a\0\0\0", "cut off"),
    (b"\x00\x01\x00\x00" + struct.pack("<I", 2) + b"a\0\0\0" + bytes(4 + 9), "9 B are left"),
], ids=["empty", "parameter list", "cdr2", "absurd length", "no zero byte", "not utf-8", "truncated", "too long"])
def test_a_message_that_does_not_fit_is_named_and_the_others_go_on(payload, reason, channel_of, batch_of):
    channel = channel_of("p/msg/T", "string name\nuint8[] data")
    good = b"\x00\x01\x00\x00" + struct.pack("<I", 2) + b"a\0\0\0" + struct.pack("<I", 1) + b"x"
    fields = decoder(channel).decode(batch_of(channel, [good, payload, good]))
    assert fields.rows.tolist() == [0, 2]
    assert fields.texts["name"] == ["a", "a"]
    [(row, why)] = fields.bad
    assert row == 1
    assert reason in why


@pytest.mark.parametrize("fields", [
    f"T2[] many\n{SEPARATOR}\nMSG: p/T2\nfloat64[4000000000] x\nstring[] s\n",
    f"T2[4000000000] many\n{SEPARATOR}\nMSG: p/T2\nint8 x\n",
    "string[] many",
], ids=["of large elements", "declared", "of texts"])
def test_a_count_of_billions_costs_no_memory_and_no_time(fields, channel_of, batch_of):
    channel = channel_of("p/msg/T", fields)
    payload = b"\x00\x01\x00\x00" + struct.pack("<I", 0x7FFFFFFF) + bytes(1000)
    tracemalloc.start()
    fields = decoder(channel).decode(batch_of(channel, [payload] * 3))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(fields.bad) == 3
    assert peak < 2_000_000


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, 200), at=st.integers(0, 199), byte=st.integers(0, 255))
def test_damage_is_named_or_read_but_never_raised(cut, at, byte, channel_of, batch_of):
    channel = channel_of("sensor_msgs/msg/JointState", JOINT_STATE)
    whole = joints(["one", "two", "three"], 3)
    damaged = bytearray(whole)
    damaged[at % len(whole)] = byte
    payloads = [whole, whole[: min(cut, len(whole) - 1)], bytes(damaged), whole]
    fields = decoder(channel).decode(batch_of(channel, payloads))
    assert {0, 3} <= set(fields.rows.tolist())
    assert 1 in [row for row, _ in fields.bad]
    assert sorted([*fields.rows.tolist(), *(row for row, _ in fields.bad)]) == [0, 1, 2, 3]


@pytest.mark.parametrize("width", [4, 2], ids=["Fast DDS: 4 bytes", "UTF-16"])
def test_wide_texts_are_read_in_both_widths(width, channel_of, batch_of):
    channel = channel_of("p/msg/T", 'wstring a "hey"\nfloat64 x')
    words = "größe".encode("utf-32-le" if width == 4 else "utf-16-le")
    body = struct.pack("<I", 5) + words
    payload = b"\x00\x01\x00\x00" + body + bytes(-len(body) % 8) + struct.pack("<d", 0.5)
    fields = decoder(channel).decode(batch_of(channel, [payload] * 2))
    assert (fields.texts["a"], fields.values["x"].tolist()) == (["größe"] * 2, [0.5] * 2)


def test_an_empty_type_is_one_byte(channel_of, batch_of):
    channel = channel_of("p/msg/T", f"E nothing\nuint16 x\n{SEPARATOR}\nMSG: p/E\nuint8 CONSTANT=3\n")
    fields = decoder(channel).decode(batch_of(channel, [b"\x00\x01\x00\x00\x00\x00\x07\x00"]))
    assert list(fields.values) == ["x"]
    assert fields.values["x"].tolist() == [7]


@pytest.mark.parametrize("name", ["s/JointState", "s/msg/JointState", "s::msg::JointState"])
@pytest.mark.parametrize("inner", ["Header", "std_msgs/Header", "std_msgs/msg/Header"])
def test_type_names_may_come_with_and_without_msg(name, inner, channel_of, batch_of):
    schema = JOINT_STATE.replace("std_msgs/Header header", f"{inner} header").replace("\n", "\r\n")
    channel = channel_of(name, schema)
    fields = decoder(channel).decode(batch_of(channel, [joints(["a"], 1)]))
    assert fields.values["position"].tolist() == [[10.0]]


@pytest.mark.parametrize(("schema", "reason"), [
    ("string request\n---\nstring response", "service definition"),
    ("other_msgs/Thing thing", "does not define"),
    ("float64 x\n9 is no field", "no field"),
    ("T again", "holds itself"),
    ("float64[0] x", "array of no elements"),
    (f"B[] b\n{SEPARATOR}\nMSG: p/B\n" + "\n".join(f"float64 x{k}" for k in range(5000)), "more than 4096 fields"),
], ids=["service", "unknown type", "prose", "recursive", "no elements", "endless"])
def test_a_schema_that_cannot_be_used_is_refused_with_a_mend(schema, reason, channel_of):
    with pytest.raises(RecordingError, match=rf"(?s){reason}.*at: +/topic.*mend: .*out of the map"):
        decoder(channel_of("p/msg/T", schema))


def test_an_unknown_encoding_is_refused_with_those_that_are_known(channel_of):
    with pytest.raises(RecordingError, match=r"(?s)encoded as ros1 with schema ros1msg, known are cdr with .*raw file"):
        decoder(channel_of("p/T", "float64 x", "ros1", "ros1msg"))


def test_what_the_ros2_writer_of_mcap_makes_is_read(tmp_path):
    stream = BytesIO()
    writer = Writer(stream)
    definition = "float64[] data\nstring label\nuint8 OK=1\nbool[2] flags"
    schema = writer.register_msgdef("p/msg/Array", definition)
    for k in range(5):
        writer.write_message("array", schema, {"data": [k, 2.5], "label": f"n{k}", "flags": [True, False]}, k, k, k)
    writer.finish()
    (tmp_path / "a.mcap").write_bytes(stream.getvalue())
    with open_log(tmp_path / "a.mcap") as log:
        [fields] = [decoder(batch.channel).decode(batch) for batch in log.batches()]
    assert fields.values["data"].tolist() == [[float(k), 2.5] for k in range(5)]
    assert fields.values["flags"].tolist() == [[True, False]] * 5
    assert fields.texts["label"] == [f"n{k}" for k in range(5)]


@pytest.mark.skipif(not LOGS.exists(), reason="recordings of others are not part of the project")
def test_recordings_of_others_are_read_whole():
    found = {}
    for path in sorted(LOGS.glob("*.mcap")):
        with open_log(path) as log:
            for batch in log.batches():
                fields = decoder(batch.channel).decode(batch)
                assert fields.bad == (), path
                found[batch.channel.topic] = fields
    assert found["/topic"].texts["data"][:2] == ["Hello, world! 0", "Hello, world! 1"]
    assert found["/one_shot/joint_state"].names["name"] == [("joint1", "joint2", "joint3")]
    assert found["/one_shot/imu"].texts["header.frame_id"] == ["imu_link"]
    assert found["/array_topic"].values["basic_types_values.float64_value"].shape == (4, 3)
    assert found["/test_topic"].values["uint64_value"].dtype == np.uint64
