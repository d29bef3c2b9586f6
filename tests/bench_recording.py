"""Writing and reading 200 ticks of an arm (18 topics and 130 numbers of simulator state a tick), zstd and CRCs on.

Beside it the mcap library's Writer with the same messages, already encoded: the most that it can do. Rates are
messages a CPU second of one core, because wall time on a shared machine says little.
Run: OMP_NUM_THREADS=1 pytest tests/bench_recording.py -s
"""

import io
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from pipeline.recording import Recording, read_episode, read_frames, write_episode, write_episodes
from pipeline.recording.write import encode
from pipeline.trace import Event, Shadow, Trace
from schemas.episode import Episode, Outcome, Segment
from schemas.scene import SceneSpec

TICKS = 200
SCENE = SceneSpec(family="demo", seed=1, robot="arm", scene="table", task="pick-place", stratum="common",
                  object_xy_m=(0.3, 0.0), object_yaw_rad=0.1, object_half_m=0.02, target_xy_m=(0.3, 0.1))
EPISODE = Episode(id="00112233445566aa", origin="scripted", scene=SCENE, control_hz=20, frames=TICKS, generation=0,
                  outcome=Outcome(label="success", judged_by="simulator"),
                  segments=(Segment(kind="demonstration", start=0, stop=TICKS, actor="expert"),))


@pytest.fixture(scope="module")
def trace() -> Trace:
    """Random walks, as smooth as joints move."""
    rng = np.random.default_rng(0)

    def walk(*shape: int) -> np.ndarray:
        return (rng.standard_normal((TICKS, *shape)) * 0.01).cumsum(0)

    return Trace(hz=20.0, state=walk(16), environment=walk(7), action=walk(5), joint_action=walk(7),
                 joint_velocity=walk(7), joint_effort=walk(7), links=tuple(f"link{k}" for k in range(11)),
                 link_poses=walk(11, 7), phase=tuple("reach" if t < 90 else "carry" for t in range(TICKS)),
                 reward={name: walk() for name in ("reach", "grasp", "lift", "place", "smooth")}, sim_state=walk(130),
                 controller=walk(60), shadows={"0123456789abcdef": Shadow(walk(7), walk())},
                 events=(Event(150, 30, "stall", "no progress"),))


def rate(work: Callable[[], object], messages: int, rounds: int = 20) -> float:
    """Messages a CPU second, the median of some rounds."""
    spent: list[float] = []
    for _ in range(rounds):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return messages / float(np.median(spent))


def test_write_beside_the_mcap_library(benchmark, trace, tmp_path):
    path = tmp_path / "a.mcap"
    write_episode(path, EPISODE, trace, attachments={})
    data = path.read_bytes()
    with path.open("rb") as stream:
        found = list(make_reader(stream).iter_messages())
    theirs = rate(lambda: library_writes(found), len(found), rounds=5)
    ours = rate(lambda: write_episode(path, EPISODE, trace, attachments={}), len(found))
    memory = rate(lambda: b"".join(encode(Recording(path, EPISODE, trace, {})).pieces), len(found))
    benchmark.pedantic(write_episode, (path, EPISODE, trace), {"attachments": {}}, rounds=10)
    benchmark.extra_info |= {"messages_per_cpu_s": ours, "encoded_per_cpu_s": memory, "library_per_cpu_s": theirs}
    print(f"\n{len(found)} messages, {len(data) >> 10} KiB: {ours:,.0f} a CPU second to a synced file, "
          f"{memory:,.0f} in memory; mcap library {theirs:,.0f} in memory: {memory / theirs:.1f} times, "
          "with its encoding not counted")
    assert ours > 500_000  # the demo's 650 episodes of 50 to 200 ticks in about 2 s


def library_writes(found: list[tuple]) -> None:
    """The mcap library's Writer: the same messages, already encoded, the same options."""
    writer = Writer(io.BytesIO(), chunk_size=1 << 18, enable_data_crcs=True)
    writer.start(profile="ros2")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for schema, channel, message in found:
        if schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(channel.topic, "cdr", schemas[schema.id])
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
    writer.finish()


@pytest.mark.parametrize("read", [read_frames, read_episode])
def test_read_beside_the_mcap_library(benchmark, trace, tmp_path, read):
    path = tmp_path / "a.mcap"
    write_episode(path, EPISODE, trace, attachments={})

    def library() -> int:
        with path.open("rb") as stream:
            return sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())

    messages = library()
    ours, theirs = rate(lambda: read(path), messages), rate(library, messages, rounds=3)
    benchmark.pedantic(read, (path,), rounds=10)
    benchmark.extra_info |= {"messages_per_cpu_s": ours, "library_per_cpu_s": theirs}
    print(f"\n{read.__name__}: {ours:,.0f} messages a CPU second into arrays; mcap library {theirs:,.0f}, not decoded: "
          f"{ours / theirs:.0f} times")
    assert ours > 500_000  # a dataset version reads some hundred recordings


@pytest.mark.parametrize("together", [True, False], ids=["together", "one by one"])
def test_write_150_episodes_durably(benchmark, trace, tmp_path, together):
    """A generation's deployment; the disk's share shows in wall time only."""
    items = [Recording(Path(tmp_path / f"{k}.mcap"), EPISODE, trace, {}) for k in range(150)]

    def write() -> None:
        for group in [items] if together else [[item] for item in items]:
            write_episodes(group)

    benchmark.pedantic(write, rounds=3)
    print(f"\n150 episodes {'together' if together else 'one by one'}: {benchmark.stats['median']:.2f} s of wall time")
    assert benchmark.stats["median"] < 10  # [s]
