"""ROS 2 messages whose types a log declares in IDL."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_idl, get_typestore

from pipeline.errors import RecordingError
from pipeline.logs.decode import decoder

IDL = """
// generated from rosidl_adapter/resource/msg.idl.em
module p {
  module msg {
    module State_Constants {
      @verbatim (language="comment", text="struct in a comment { double x; };" "\\n")
      const uint8 JOINTS = 3;
      const string NAME = "semi; colon";
    };
    typedef p::msg::Point p__msg__Point;
    typedef p__msg__Point p__msg__Point__2[2];
    typedef double double__3[3];
    /* struct Old { long gone; }; */
    @verbatim (language="comment", text=
      "A state." "\\n"
      "Of an arm.")
    struct State {
      @unit (value="rad")
      double__3 position;
      boolean ok;
      @default (value=7)
      unsigned short mode;
      long long ticks;
      string<20> label;
      sequence<string> names;
      sequence<double, 5> effort;
      sequence<octet> picture;
      p__msg__Point__2 corners;
      sequence<p__msg__Point> path;
      unsigned long a, b;
    };
    struct Point { float x; float y; };
  };
};
"""


def test_types_in_idl_are_read_as_rosbags_reads_them(channel_of, batch_of):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_idl(IDL))
    Point, State = store.types["p/msg/Point"], store.types["p/msg/State"]
    point = Point(1.5, -2.5)
    message = State(np.array([1.0, 2.0, 3.0]), True, 9, -(2**40), "né", ["a", "bc"], np.array([0.5, 0.25]),
                    np.arange(5, dtype=np.uint8), [point, Point(3.0, 4.0)], [point], 4, 2**32 - 1)
    payload = bytes(store.serialize_cdr(message, "p/msg/State"))
    channel = channel_of("p/msg/State", f"{'=' * 80}\nIDL: p/msg/State\n{IDL}", schema_encoding="ros2idl")
    fields = decoder(channel).decode(batch_of(channel, [payload] * 3))
    assert fields.bad == ()
    assert {path: column[2].tolist() for path, column in fields.values.items()} == {
        "position": [1.0, 2.0, 3.0], "ok": True, "mode": 9, "ticks": -(2**40), "effort": [0.5, 0.25],
        "corners.x": [1.5, 3.0], "corners.y": [-2.5, 4.0], "path.x": [1.5], "path.y": [-2.5], "a": 4, "b": 2**32 - 1}
    assert fields.texts["label"] == ["né"] * 3
    assert fields.names["names"] == [("a", "bc")] * 3
    assert bytes(fields.blobs["picture"][0]) == bytes(range(5))


def test_a_header_may_come_from_a_file_of_its_own(channel_of, batch_of):
    text = ('IDL: p/msg/T\n#include "builtin_interfaces/msg/Time.idl"\n'
            "module p { module msg { struct T { builtin_interfaces::msg::Time stamp; @key int8 x; }; }; };\n"
            f"{'=' * 80}\nIDL: builtin_interfaces/msg/Time\n"
            "module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };\n")
    channel = channel_of("p/msg/T", text, schema_encoding="ros2idl")
    payload = b"\x00\x01\x00\x00" + (5).to_bytes(4, "little") + (7).to_bytes(4, "little") + b"\xff"
    fields = decoder(channel).decode(batch_of(channel, [payload]))
    assert fields.header_ns.tolist() == [5 * 10**9 + 7]
    assert fields.values["x"].tolist() == [-1]


@pytest.mark.parametrize(("body", "reason"), [
    ("struct T { @optional double x; };", "optional"),
    ("union U switch(long) { case 1: double x; };", "'union' is not understood"),
    ("struct T { double x", "ends early"),
    ("struct T { sequence<sequence<double>> x; };", "sequence of sequences"),
    ("typedef double d[2]; struct T { sequence<d> x; };", "no plain"),
    ("struct T { Gone x; };", "does not define"),
    ("struct Other { long x; };", "does not define p/T"),
    ("typedef a b; typedef b a; struct T { a x; };", "does not define"),
    ("struct T { " + "sequence<" * 5000, "cannot be read"),
    ("struct T { T again; };", "holds itself"),
], ids=["optional", "union", "cut off", "sequences", "arrays", "unknown", "missing", "circular", "deep", "self"])
def test_idl_that_cannot_be_used_is_refused_with_a_mend(body, reason, channel_of):
    channel = channel_of("p/msg/T", f"module p {{ module msg {{ {body} }}; }};", schema_encoding="ros2idl")
    with pytest.raises(RecordingError, match=rf"(?s){reason}.*at: +/topic.*mend: .*out of the map"):
        decoder(channel)
