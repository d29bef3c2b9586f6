"""Logs that mutants are made of: ours and those of other writers, small, each with its own habits."""

import io
import json
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer

from pipeline.recording import cdr, write_episode
from pipeline.recording.dialect import definition
from pipeline.trace import Trace
from schemas.episode import Episode, Outcome, Segment
from schemas.scene import SceneSpec

SHARED = Path(__file__).parents[3] / "shared/logs"
EPOCH_NS = 1_700_000_000_000_000_000


def seeds(folder: Path) -> dict[str, bytes]:
    """Name -> bytes; the foreign logs of this machine too, where it has them."""
    made = {
        "ours": ours(folder),
        "cameras": cameras(),
        "cdr": foreign("cdr", CompressionType.ZSTD),
        "cdr with data CRC": foreign("cdr", CompressionType.ZSTD, enable_data_crcs=True),
        "json in lz4": foreign("json", CompressionType.LZ4, enable_data_crcs=True),
        "protobuf, plain chunks": foreign("protobuf", CompressionType.NONE),
        "no chunks": foreign("cdr", CompressionType.NONE, enable_data_crcs=True, use_chunking=False),
        "no chunks, no CRC": foreign("json", CompressionType.NONE, enable_crcs=False, use_chunking=False),
        "tiny chunks": foreign("json", CompressionType.LZ4, chunk_size=700),
        "no summary": foreign("cdr", CompressionType.ZSTD, enable_data_crcs=True, index_types=IndexType.NONE,
                              use_statistics=False, repeat_channels=False, repeat_schemas=False,
                              use_summary_offsets=False),
    }
    found = {path.name: path.read_bytes() for path in sorted(SHARED.glob("*.mcap"))} if SHARED.is_dir() else {}
    return made | found


def ours(folder: Path) -> bytes:
    """A recording of this project."""
    rng, m = np.random.default_rng(1), 60

    def walk(*shape: int) -> np.ndarray:
        return np.cumsum(rng.normal(scale=0.01, size=(m, *shape)), axis=0)

    scene = SceneSpec(family="demo", seed=1, robot="arm", scene="table", task="pick-place", stratum="common",
                      object_xy_m=(0.3, 0.0), object_yaw_rad=0.1, object_half_m=0.02, target_xy_m=(0.3, 0.1))
    episode = Episode(id="00112233445566aa", origin="scripted", scene=scene, control_hz=20, frames=m, generation=0,
                      outcome=Outcome(label="success", judged_by="simulator"),
                      segments=(Segment(kind="demonstration", start=0, stop=m, actor="expert"),))
    trace = Trace(hz=20.0, state=walk(16), environment=walk(7), action=walk(5), joint_action=walk(7),
                  joint_velocity=walk(7), joint_effort=walk(7), links=("base", "link1"), link_poses=walk(2, 7),
                  phase=("reach",) * m, reward={"reach": walk()}, sim_state=walk(20), controller=walk(8), shadows={},
                  events=())
    path = folder / "ours.mcap"
    write_episode(path, episode, trace, attachments={"scene.xml": b"<mujoco/>", "config.json": b"{}"})
    return path.read_bytes()


def cameras() -> bytes:
    """Joints and two cameras in our dialect, chunks closed often, as while a robot moves."""
    rng, out = np.random.default_rng(2), io.BytesIO()
    writer = Writer(out, chunk_size=12_000, enable_data_crcs=True)
    writer.start("ros2", "test")
    joints, image = "sensor_msgs/msg/JointState", "sensor_msgs/msg/CompressedImage"
    kinds = {name: writer.register_schema(name, "ros2msg", definition(name).encode()) for name in (joints, image)}
    channels = [writer.register_channel("/joint_states", "cdr", kinds[joints])]
    channels += [writer.register_channel(f"/camera/{c}/image/compressed", "cdr", kinds[image]) for c in ("a", "b")]
    layout = cdr.joint_state(("j1", "j2", "j3"), velocity=True, effort=False).template
    for tick in range(40):
        stamp = EPOCH_NS + tick * 20_000_000
        writer.add_message(channels[0], stamp, layout[:-8] + rng.bytes(8), stamp, tick)
        for channel in channels[1:] if tick % 2 else []:
            picture = b"\xff\xd8" + rng.bytes(400) + b"\xff\xd9"
            writer.add_message(channel, stamp, cdr.compressed_image(stamp, "cam", "jpeg", picture), stamp, tick)
    writer.finish()
    return out.getvalue()


def foreign(encoding: str, compression: CompressionType, **options: object) -> bytes:
    """Other people's habits: latched messages at time 0, topics without a slash, JSON under ROS names, no schema."""
    rng, out = np.random.default_rng(3), io.BytesIO()
    writer = Writer(out, compression=compression, **{"chunk_size": 3000, **options})
    writer.start("" if encoding == "json" else "ros2", "somebody else")
    writer.add_metadata("site", {"plant": "7", "line": "B"})
    schema = writer.register_schema("sensor_msgs/JointState", "ros2msg", b"float64[] position\n")
    state = writer.register_channel("joint_states", encoding, schema, {"offered_qos": "latched"})
    text = writer.register_channel("/log", "json", 0)
    latched = writer.register_channel("/description", encoding, schema)
    writer.add_message(latched, 0, b"<robot/>" * 20, 0, 0)
    for k in range(150):
        stamp = EPOCH_NS + k * 10_000_000 + int(rng.integers(0, 1_000_000))
        writer.add_message(state, stamp, rng.bytes(int(rng.integers(20, 90))), stamp - 5, k)
        if k % 7 == 0:
            writer.add_message(text, stamp, json.dumps({"k": k, "note": "é" * (k % 5)}).encode(), stamp, 0)
    writer.add_attachment(EPOCH_NS, EPOCH_NS, "robot.urdf", "application/xml", b"<robot name='r'/>" * 9)
    writer.finish()
    return out.getvalue()
