"""Converting logs of other people on one core: CDR, small chunks, JSON, cameras; memory on a large one.

A log goes through everything that `hardcase ingest` does in its child: read and checked, decoded, spooled, resampled,
written. Beside it what a user would write instead: the loop over rosbags' deserialised messages that fills the same
arrays, without resampling. Figures are CPU seconds, because wall time on a shared machine says little.
Run: OMP_NUM_THREADS=1 pytest tests/bench_ingest.py -s; HARDCASE_BENCH_GB=5 for the large log
"""

import json
import os
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zstandard
from rosbags.highlevel import AnyReader

from flows.data.ingesting import Ingest
from pipeline.logs.child import Children, Limits
from pipeline.logs.convert import convert
from pipeline.recording import cdr, records
from pipeline.recording.dialect import definition
from pipeline.recording.records import Op
from pipeline.store import Store
from schemas.ingest import IngestMap

GIGABYTES = float(os.environ.get("HARDCASE_BENCH_GB", "1"))
EPOCH_NS = 1_700_000_000_000_000_000
JOINTS, IMAGE = "sensor_msgs/msg/JointState", "sensor_msgs/msg/CompressedImage"
CAMERA_BYTES = 40_000
"""A 640 x 480 JPEG of usual quality."""
NAMES = tuple(f"joint{k}" for k in range(7))
LAYOUT = cdr.joint_state(NAMES, velocity=True, effort=True)
HZ = 500


def chunks(kind: str, size: float, *, arms: int, cameras: int, ticks: int) -> Iterator[tuple[bytes, int]]:
    """Chunks of `ticks` at 500 Hz until there are `size` bytes, and how many messages each has."""
    rng, packer, tick, written = np.random.default_rng(0), zstandard.ZstdCompressor(level=1), 0, 0
    pictures = [b"\xff\xd8\xff" + rng.bytes(CAMERA_BYTES) for _ in range(50)]
    head = records.schema(1, JOINTS, "ros2msg", definition(JOINTS)) + records.schema(2, IMAGE, "ros2msg",
                                                                                     definition(IMAGE))
    head += b"".join(records.channel(k + 1, 0 if kind == "json" else 1, f"/arm{k}/joint_states", kind)
                     for k in range(arms))
    head += b"".join(records.channel(k + 21, 2, f"/camera{k}", "cdr") for k in range(cameras))
    picture = records_of_picture()
    while written < size:
        parts, count, positions = [head], 0, rng.normal(size=(ticks, arms, 21))
        for k in range(tick, tick + ticks):
            stamp = EPOCH_NS + k * 10**9 // HZ
            parts += [records.message(a + 1, k, stamp, payload(kind, stamp, positions[k - tick, a]))
                      for a in range(arms)]
            parts += [records.message(c + 21, k, stamp, picture + pictures[(k + c) % 50])
                      for c in range(cameras) if k % 17 == 0]
            count += arms + cameras * (k % 17 == 0)
        head, plain, first = b"", b"".join(parts), EPOCH_NS + tick * 10**9 // HZ
        tick += ticks
        packed = packer.compress(plain)
        written += len(packed)
        yield records.chunk(first, stamp, len(plain), zlib.crc32(plain), "zstd", packed), count


def payload(kind: str, stamp: int, values: np.ndarray) -> bytes:
    """One JointState with positions, velocities and efforts."""
    if kind == "json":
        parts = {name: values[7 * k:7 * k + 7].tolist() for k, name in enumerate(("position", "velocity", "effort"))}
        return json.dumps({"header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}, "name": NAMES,
                           **parts}).encode()
    body = bytearray(LAYOUT.template)
    body[LAYOUT.stamps[0]:LAYOUT.stamps[0] + 8] = np.array([stamp // 10**9, stamp % 10**9], "<u4").tobytes()
    for k, (offset, count) in enumerate(LAYOUT.floats):
        body[offset:offset + 8 * count] = values[7 * k:7 * k + 7].tobytes()
    return bytes(body)


def records_of_picture() -> bytes:
    """A CompressedImage up to its bytes."""
    return cdr.Builder().stamp(EPOCH_NS).text("camera").text("jpeg").u32(CAMERA_BYTES + 3).layout().template


def write(path: Path, kind: str, size: float, **how: int) -> int:
    """Write a log; returns its messages."""
    crc, count = 0, 0
    with path.open("wb") as stream:
        for piece, messages in ((records.MAGIC + records.header("ros2", "bench"), 0), *chunks(kind, size, **how)):
            crc, count = zlib.crc32(piece, crc), count + messages
            stream.write(piece)
        stream.write(records.record(Op.DATA_END, crc.to_bytes(4, "little")))
        stream.write(records.record(Op.FOOTER, bytes(20)) + records.MAGIC)
    return count


def declared(arms: int, cameras: int) -> IngestMap:
    """Positions of every arm, by name and in another order than that of the messages, at 50 frames a second."""
    source = {"fields": ["position"], "joints": NAMES[::-1]}
    return IngestMap.model_validate({
        "name": "bench", "robot": "arms", "task": "bench", "fps": 50,
        "features": {f"observation.arm{k}": {**source, "topic": f"/arm{k}/joint_states"} for k in range(arms)},
        "cameras": {f"c{k}": {"topic": f"/camera{k}"} for k in range(cameras)}})


def by_rosbags(path: Path, arms: int, cameras: int) -> int:
    """The script that people write: deserialise all, put the joints in order, write the pictures down."""
    positions: dict[str, list[np.ndarray]] = {}
    with AnyReader([path]) as reader, path.with_suffix(".images").open("wb") as images:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype == IMAGE:
                images.write(message.data)
            else:
                order = [message.name.index(name) for name in NAMES[::-1]]
                positions.setdefault(connection.topic, []).append(message.position[order])
    return sum(len(np.stack(rows)) for rows in positions.values())


LOGS = {
    "state": ("cdr", 12e6, {"arms": 6, "cameras": 0, "ticks": 500}),
    "state, chunks of 150 ms": ("cdr", 12e6, {"arms": 2, "cameras": 0, "ticks": 75}),
    "state in JSON": ("json", 6e6, {"arms": 6, "cameras": 0, "ticks": 500}),
    "two cameras": ("cdr", 80e6, {"arms": 2, "cameras": 2, "ticks": 200}),
}


@pytest.mark.parametrize("name", LOGS)
def test_convert_beside_a_script(benchmark, tmp_path, name):
    kind, size, how = LOGS[name]
    path = tmp_path / "a.mcap"
    messages, megabytes = write(path, kind, size, **how), path.stat().st_size / 1e6
    asked, spent = declared(how["arms"], how["cameras"]).model_dump_json(), list[float]()

    def run() -> None:
        folder = tmp_path / str(len(spent))
        folder.mkdir()
        start = time.process_time()
        told = convert(str(path), asked, str(folder))
        spent.append(time.process_time() - start)
        assert sum(use["messages"] for use in told["topics"]) == messages
        assert len(told["spans"]) == 1

    benchmark.pedantic(run, rounds=3, warmup_rounds=1)
    mine = float(np.median(spent[1:]))
    print(f"\n{name}: {messages:,} messages, {megabytes:.0f} MB: {messages / mine:,.0f} messages/s, "
          f"{megabytes / mine:,.0f} MB/s")
    benchmark.extra_info |= {"messages_per_cpu_s": messages / mine, "mb_per_cpu_s": megabytes / mine}
    if kind == "cdr":
        start = time.process_time()
        by_rosbags(path, how["arms"], how["cameras"])
        theirs = time.process_time() - start
        benchmark.extra_info["ratio"] = theirs / mine
        print(f"  a script over rosbags: {messages / theirs:,.0f} messages/s; ours {theirs / mine:.1f} times as fast")
        assert messages / mine > 60_000 or how["cameras"]
        assert megabytes / mine > 50 or not how["cameras"]


SPAWNED = """
import sys, time
from pipeline.logs.convert import convert
told = convert(*sys.argv[1:4])
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(sum(s["frames"] for s in told["spans"]), peak.split()[1], time.process_time())
"""


@pytest.mark.parametrize("cameras", [1, 0], ids=["camera", "state only"])
def test_memory_stays_flat(tmp_path, cameras):
    """The peak over a large log is near that over a small one; a limited child converts it too."""
    peaks: list[float] = []
    asked = declared(1, cameras).model_dump_json()
    for size in (32e6, GIGABYTES * 1e9 / (1 if cameras else 5)):
        path, folder = tmp_path / "large.mcap", tmp_path / f"{size:.0f}"
        folder.mkdir()
        count = write(path, "cdr", size, arms=1, cameras=cameras, ticks=400)
        command = [sys.executable, "-c", SPAWNED, str(path), asked, str(folder)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        frames, peak, seconds = done.stdout.split()
        peaks.append(int(peak) / 1e3)
        print(f"\n{size / 1e9:.2f} GB, {count:,} messages, {int(frames):,} frames: peak {peaks[-1]:.0f} MB, "
              f"{size / 1e6 / float(seconds):,.0f} MB and {count / float(seconds):,.0f} messages a CPU second")
        for file in folder.iterdir():
            file.unlink()
        with Children() as children:
            children.call(convert, str(path), asked, str(folder), where=path,
                          limits=Limits.of(path, bytes_a_second=2.5e5))
        for file in folder.iterdir():
            file.unlink()
        path.unlink()
    assert peaks[1] < peaks[0] + 64


@pytest.mark.parametrize("name", ["state", "two cameras"])
def test_the_whole_command_into_a_store(tmp_path, name):
    """Hashing, keeping the raw file, the child, the catalog: CPU seconds of this process and its children."""
    kind, size, how = LOGS[name]
    size, path = size * 3, tmp_path / "a.mcap"
    messages, megabytes = write(path, kind, size, **how), size / 1e6
    with Store.open(tmp_path / "store", create=True) as store:
        before = sum(os.times()[:4])
        with Ingest(store, declared(how["arms"], how["cameras"])) as work:
            taken = work.take(path)
        spent = sum(os.times()[:4]) - before
    assert len(taken.episodes) == 1
    print(f"\n{name}, whole: {messages:,} messages, {megabytes:.0f} MB in {spent:.2f} CPU s: {messages / spent:,.0f} "
          f"messages/s, {megabytes / spent:,.0f} MB/s")
    assert messages / spent > 60_000 or how["cameras"]
    assert megabytes / spent > 50 or not how["cameras"]
