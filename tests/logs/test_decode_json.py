"""JSON messages, under ROS type names, under a JSON schema and under none."""

import base64
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.logs.decode import decoder


@pytest.fixture(scope="module")
def read(channel_of, batch_of):
    """Decode messages that are given as values, or as bytes where they are no JSON."""

    def decode(*messages, name="sensor_msgs/JointState", schema="", kind="ros2msg"):
        channel = channel_of(name, schema, "json", kind)
        payloads = [m if isinstance(m, bytes) else json.dumps(m).encode() for m in messages]
        return decoder(channel).decode(batch_of(channel, payloads))

    return decode


def test_json_under_a_ros_type_name_gives_the_same_columns_as_ros(read):
    fields = read(*({"header": {"stamp": {"sec": k, "nanosec": 7}, "frame_id": ""}, "name": ["a", "b"],
                     "position": [k, 0.5], "velocity": []} for k in range(3)))
    assert fields.header_ns.tolist() == [7, 10**9 + 7, 2 * 10**9 + 7]
    assert fields.names["name"] == [("a", "b")] * 3
    assert fields.values["position"].tolist() == [[0.0, 0.5], [1.0, 0.5], [2.0, 0.5]]
    assert fields.values["velocity"].shape == (3, 0)


def test_what_a_message_lacks_is_not_a_number(read):
    fields = read({"x": 1, "say": "hi"}, {"x": None}, {"say": "ho", "q": [1]}, {"x": 2, "q": [1, None]})
    np.testing.assert_array_equal(fields.values["x"], [1, np.nan, np.nan, 2])
    assert fields.texts["say"] == ["hi", "", "ho", ""]
    assert [len(row) for row in fields.ragged["q"]] == [0, 0, 1, 2]


def test_elements_of_a_sequence_are_laid_end_to_end(read):
    fields = read({"points": [{"p": [1, 2], "n": "a", "t": 0.5}, {"p": [3, 4], "n": "b", "t": 1.5}]},
                  {"points": [{"p": [5, 6], "n": "c", "t": 2.5}, {"p": [7, 8], "n": "d", "t": 3.5}]})
    assert fields.values["points.p"].tolist() == [[1, 2, 3, 4], [5, 6, 7, 8]]
    assert fields.values["points.t"].tolist() == [[0.5, 1.5], [2.5, 3.5]]
    assert fields.names["points.n"] == [("a", "b"), ("c", "d")]


@pytest.mark.parametrize(("message", "path"), [(3.5, "data"), ([1, 2], "data"), ([[1, 2], [3, 4]], "data")])
def test_a_message_may_be_no_object(message, path, read):
    fields = read(message, message)
    assert np.ravel(fields.values[path][0]).tolist() == np.ravel(message).tolist()


@pytest.mark.parametrize(("name", "schema", "kind"), [
    ("foxglove.CompressedImage", "", "jsonschema"),
    ("mine", json.dumps({"properties": {"data": {"type": "string", "contentEncoding": "base64"}}}), "jsonschema"),
    ("p/msg/Scan", "string frame\nuint8[] data", "ros2msg"),
], ids=["known picture", "content encoding", "bytes of a ROS type"])
def test_base64_is_bytes_where_the_schema_says_so(name, schema, kind, read):
    coded = base64.b64encode(b"\xff\xd8picture").decode()
    fields = read({"data": coded}, {"data": coded}, {"data": "no base64!"}, name=name, schema=schema, kind=kind)
    assert [bytes(blob) for blob in fields.blobs["data"]] == [b"\xff\xd8picture"] * 2
    assert fields.bad[0][0] == 2
    assert fields.bad[0][1].startswith("data: ")


@pytest.mark.parametrize(("odd", "reason"), [
    (b'{"x": 1', "is no JSON"),
    (b"\xff\xfe", "is no JSON"),
    (b"[" * 100_000, "is no JSON"),
    (b"", "is no JSON"),
    (b'{"x": 2, "half \\ud83d": 1}', "is no JSON"),
    ({"x": "one"}, "x is of kind text, in most messages number"),
    ([1], "the message is of kind list, in most messages object"),
], ids=["cut off", "not utf-8", "nested without end", "empty", "half a character", "other kind", "no object"])
def test_a_message_that_does_not_fit_the_others_is_named(odd, reason, read):
    fields = read({"x": 1.5}, odd, {"x": 2.5})
    assert fields.rows.tolist() == [0, 2]
    assert fields.values["x"].tolist() == [1.5, 2.5]
    [(row, why)] = fields.bad
    assert row == 1
    assert reason in why


@pytest.mark.parametrize(("spoiler", "reason"), [
    ({f"k{k}": 1 for k in range(5000)}, "4096 different fields"),
    (json.loads('{"y":' * 300 + "1" + "}" * 300), "32 deep"),
    ({"y": json.loads("[" * 300 + "1" + "]" * 300)}, "32 deep"),
], ids=["endless", "deep", "deep lists"])
def test_one_message_does_not_spoil_its_batch(spoiler, reason, read):
    fields = read({"x": 1.5}, spoiler, {"x": 2.5})
    assert fields.values["x"].tolist() == [1.5, 2.5]
    [(row, why)] = fields.bad
    assert row == 1
    assert reason in why


def test_fields_that_are_ever_others_are_refused_and_counted(read):
    fields = read(*({f"k{n}_{k}": 1 for k in range(3000)} for n in range(2)))
    assert len(fields) == 0
    assert [row for row, _ in fields.bad] == [0, 1]


def test_a_character_of_two_escapes_is_text(read):
    assert read(b'{"x": "\\ud83d\\ude00"}').texts["x"] == ["\U0001f600"]


def test_numbers_too_large_for_an_integer_stay_numbers(read):
    fields = read({"a": 2**70, "b": 10**400, "c": 2**62}, {"a": 1, "b": 1, "c": -1})
    assert fields.values["a"].tolist() == [2.0**70, 1.0]
    assert fields.values["b"].tolist() == [np.inf, 1.0]
    assert fields.values["c"].tolist() == [2**62, -1]


plain = st.one_of(st.floats(allow_nan=False), st.integers(-(2**63), 2**63 - 1), st.text(max_size=5), st.booleans())


nested = st.recursive(plain, lambda x: st.dictionaries(st.sampled_from("uvw"), x), max_leaves=8)


@given(message=st.dictionaries(st.sampled_from("abcde"), nested), count=st.integers(1, 4))
def test_every_scalar_is_read_as_it_was_written(message, count, read):
    fields = read(*[message] * count)

    def leaves(value, path):
        if isinstance(value, dict):
            for key, inner in value.items():
                yield from leaves(inner, f"{path}.{key}" if path else key)
        else:
            yield path, value

    for path, value in leaves(message, ""):
        column = fields.texts[path] if isinstance(value, str) else fields.values[path].tolist()
        assert column == [value] * count
        assert type(column[0]) is type(value)
