"""Decoding 2,000 messages of each kind into columns, beside the libraries that give one object a message.

Batches of 60 messages, as a chunk holds of one topic where several are recorded, and of 1,000. Others: rosbags and
mcap-ros2, which stop at one object a message; json.loads and protobuf's FromString, with np.array of the three
sequences of numbers, which is the least that somebody does who wants to count with them. Rates are messages a CPU
second of one core.
Run: OMP_NUM_THREADS=1 pytest -o python_files='bench_*.py' tests/bench_decode.py -s
"""

import json
import time
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_typestore

from pipeline.logs.decode import decoder
from pipeline.logs.stream import Batch, Channel

COUNT = 2000
STORE = get_typestore(Stores.ROS2_HUMBLE)
SEQUENCES = ("position", "velocity", "effort")
JOINTS = [f"joint{k}" for k in range(7)]


def ros(name: str, *values):
    """A message of rosbags; a type of one word is of package geometry_msgs."""
    return STORE.types[f"geometry_msgs/msg/{name}" if "/" not in name else name](*values)


def header(k: int):
    return ros("std_msgs/msg/Header", ros("builtin_interfaces/msg/Time", k // 100, k % 100 * 10_000_000), "base")


def joint_state(k: int):
    values = np.sin(np.arange(7.0) + k)
    return ros("sensor_msgs/msg/JointState", header(k), JOINTS, values, values, values)


def array(k: int):
    layout = ros("std_msgs/msg/MultiArrayLayout", [], 0)
    return ros("std_msgs/msg/Float64MultiArray", layout, np.arange(7.0) + k)


def imu(k: int):
    flat, turn = np.zeros(9), ros("Quaternion", 0.0, 0.0, 0.0, 1.0)
    return ros("sensor_msgs/msg/Imu", header(k), turn, flat, ros("Vector3", 1.0, 2.0, float(k)), flat,
               ros("Vector3", 0.0, 0.0, 9.8), flat)


def image(k: int):
    return ros("sensor_msgs/msg/CompressedImage", header(k), "jpeg", np.zeros(20_000 + k % 97, np.uint8))


def transforms(k: int):
    pose = ros("Transform", ros("Vector3", 1.0, 2.0, float(k)), ros("Quaternion", 0.0, 0.0, 0.0, 1.0))
    links = [ros("TransformStamped", header(k), f"link{n}", pose) for n in range(8)]
    return ros("tf2_msgs/msg/TFMessage", links)


def log(k: int):
    """A message whose layout is never that of the one before."""
    stamp = ros("builtin_interfaces/msg/Time", k, 0)
    return ros("rcl_interfaces/msg/Log", stamp, 20, "n" * (k % 13), "m" * (k % 31), "f", "g" * (k % 7), k)


def values(k: int) -> dict[str, list[float]]:
    return {name: [k + n / 7 for n in range(7)] for name in SEQUENCES}


def arrays(message: dict[str, list[float]]) -> list[np.ndarray]:
    return [np.array(message[name]) for name in SEQUENCES]


KINDS = {"sensor_msgs/msg/JointState": joint_state, "std_msgs/msg/Float64MultiArray": array, "sensor_msgs/msg/Imu": imu,
         "sensor_msgs/msg/CompressedImage": image, "tf2_msgs/msg/TFMessage": transforms, "rcl_interfaces/msg/Log": log}
WORST = {"rcl_interfaces/msg/Log"}


def rate(work: Callable[[], object], rounds: int = 5) -> float:
    """Messages a CPU second, the best of some rounds."""
    spent: list[float] = []
    for _ in range(rounds):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return COUNT / min(spent)


def batches(channel: Channel, payloads: Sequence[bytes], size: int) -> list[Batch]:
    made: list[Batch] = []
    for first in range(0, len(payloads), size):
        part = payloads[first : first + size]
        sizes = np.array([len(payload) for payload in part], np.int64)
        ns = np.arange(len(part), dtype=np.int64)
        made.append(Batch(channel, b"".join(part), np.cumsum(sizes) - sizes, sizes, ns, ns, ns.astype(np.uint32)))
    return made


def ours(channel: Channel, payloads: Sequence[bytes], size: int) -> float:
    made, decode = batches(channel, payloads, size), decoder(channel).decode
    return rate(lambda: [decode(batch) for batch in made])


def told(name: str, channel: Channel, payloads: Sequence[bytes], others: dict[str, Callable[[bytes], object]]) -> float:
    """Print one line of the table; gives our rate in small batches over the fastest other's."""
    small, large = ours(channel, payloads, 60), ours(channel, payloads, 1000)
    rates = {other: rate(lambda parse=parse: [parse(payload) for payload in payloads], 3)
             for other, parse in others.items()}
    beside = ", ".join(f"{other} {found:,.0f} ({small / found:.1f} x)" for other, found in rates.items())
    print(f"\n{name}: ours {small:,.0f} in batches of 60, {large:,.0f} of 1,000; {beside}")
    return small / max(rates.values())


@pytest.mark.parametrize("name", KINDS)
def test_ros2_beside_rosbags_and_mcap_ros2(name):
    payloads = [bytes(STORE.serialize_cdr(KINDS[name](k), name)) for k in range(COUNT)]
    text = STORE.generate_msgdef(name, ros_version=2)[0]
    short = name.replace("/msg/", "/")
    channel = Channel(1, "/topic", "cdr", name, "ros2msg", text.encode(), {})
    ratio = told(short, channel, payloads, {"rosbags": lambda p: STORE.deserialize_cdr(p, name),
                                            "mcap-ros2": generate_dynamic(short, text)[short]})
    assert ratio > (0.1 if name in WORST else 2)


def test_json_beside_the_standard_library():
    payloads = [json.dumps({"header": {"stamp": {"sec": k, "nanosec": 5}, "frame_id": ""}, "name": JOINTS,
                            **values(k)}).encode() for k in range(COUNT)]
    channel = Channel(1, "/topic", "json", "sensor_msgs/JointState", "ros2msg", b"", {})
    other = {"json.loads and np.array": lambda p: arrays(json.loads(p))}
    assert told("JSON JointState", channel, payloads, other) > 0.5


def test_protobuf_beside_its_own_parser():
    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="p.proto", package="p")
    message = file.message_type.add(name="State")
    for number, (name, kind) in enumerate({"name": 9, "position": 1, "velocity": 1, "effort": 1}.items(), 1):
        message.field.add(name=name, number=number, type=kind, label=3)
    pool = DescriptorPool()
    pool.Add(file)
    made = GetMessageClass(pool.FindMessageTypeByName("p.State"))
    payloads = [made(name=JOINTS, **values(k)).SerializeToString() for k in range(COUNT)]
    channel = Channel(1, "/topic", "protobuf", "p.State", "protobuf", files.SerializeToString(), {})

    def parse(payload: bytes) -> list[np.ndarray]:
        message = made.FromString(payload)
        return [np.array(getattr(message, name)) for name in SEQUENCES]

    assert told("protobuf State", channel, payloads, {"FromString and np.array": parse}) > 0.5
