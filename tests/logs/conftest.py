"""Channels and batches made by hand, for decoders; and logs as other people's robots write them."""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from mcap_ros2._dynamic import serialize_dynamic

from pipeline.logs.stream import Batch, Channel


@pytest.fixture(scope="session")
def channel_of() -> Callable[..., Channel]:
    """A channel as a log would declare it."""

    def make(name: str, schema: str | bytes, encoding: str = "cdr", schema_encoding: str = "ros2msg") -> Channel:
        data = schema.encode() if isinstance(schema, str) else schema
        return Channel(1, "/topic", encoding, name, schema_encoding, data, {})

    return make


@pytest.fixture(scope="session")
def batch_of() -> Callable[[Channel, Sequence[bytes]], Batch]:
    """A batch of payloads, with bytes of somebody else before, between and behind them."""

    def make(channel: Channel, payloads: Sequence[bytes]) -> Batch:
        between = b"\xa5" * 31
        sizes = np.array([len(payload) for payload in payloads], np.int64)
        starts = np.cumsum(sizes + len(between)) - sizes
        data = b"".join(between + payload for payload in payloads) + between
        ns = np.arange(len(payloads), dtype=np.int64)
        return Batch(channel, data, starts, sizes, ns, ns, ns.astype(np.uint32))

    return make


LOG_START = 1_760_000_000 * 10**9
LINE = "=" * 80
HEADER = f"{LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
TYPES = {
    "sensor_msgs/msg/JointState": f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
                                  f"float64[] effort\n{HEADER}",
    "trajectory_msgs/msg/JointTrajectory":
        f"std_msgs/Header header\nstring[] joint_names\nJointTrajectoryPoint[] points\n{HEADER}{LINE}\n"
        "MSG: trajectory_msgs/JointTrajectoryPoint\nfloat64[] positions\nbuiltin_interfaces/Duration time_from_start\n",
    "sensor_msgs/msg/CompressedImage": f"std_msgs/Header header\nstring format\nuint8[] data\n{HEADER}",
    "std_msgs/msg/Float64MultiArray":
        f"MultiArrayLayout layout\nfloat64[] data\n{LINE}\nMSG: std_msgs/MultiArrayLayout\nMultiArrayDimension[] dim\n"
        f"uint32 data_offset\n{LINE}\nMSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n",
    "geometry_msgs/msg/Twist": f"Vector3 linear\nVector3 angular\n{LINE}\nMSG: geometry_msgs/Vector3\nfloat64 x\n"
                               "float64 y\nfloat64 z\n",
    "std_msgs/msg/String": "string data",
}


class ForeignLog:
    """A log that is being written; `at` counts seconds from its start, None is log time 0."""

    def __init__(self, writer, path):
        self._writer, self.path, self._channels = writer, path, {}

    def channel(self, topic, name, encoding, schema, message_encoding):
        if topic not in self._channels:
            number = self._writer.register_schema(name, encoding, schema) if name else 0
            self._channels[topic] = self._writer.register_channel(topic, message_encoding, number)
        return self._channels[topic]

    def put(self, channel, at, data):
        ns = LOG_START + round(at * 1e9) if at is not None else 0
        self._writer.add_message(channel, ns, data, ns)

    def ros(self, topic, kind, at, message, text=None):
        name = kind.replace("/msg/", "/")
        text = text or TYPES.get(kind) or TYPES[name.replace("/", "/msg/")]
        channel = self.channel(topic, kind, "ros2msg", text.encode(), "cdr")
        self.put(channel, at, serialize_dynamic(name, text)[name](message))

    def json(self, topic, at, message, name="", encoding=""):
        self.put(self.channel(topic, name, encoding, b"", "json"), at, json.dumps(message).encode())


@pytest.fixture
def foreign_log(tmp_path: Path):
    """Opens a log for writing as a context; its path is `.path` of what that gives."""

    @contextmanager
    def write() -> Iterator[ForeignLog]:
        path = tmp_path / "Their Log-01.mcap"
        with path.open("wb") as stream:
            writer = Writer(stream, chunk_size=1 << 16, compression=CompressionType.ZSTD)
            writer.start("ros2", "test")
            yield ForeignLog(writer, path)
            writer.finish()

    return write
