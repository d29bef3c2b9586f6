"""kill -9 in the middle of a recording with cameras: at most 0.25 s of robot time is lost, the rest is whole."""

import os
import signal
import struct
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from pipeline.recording import read_episode, read_frames, recover

CHILD = Path(__file__).with_name("live_child.py")
KILLS, HZ, AT_ONCE = int(os.environ.get("HARDCASE_KILLS", "10")), 50.0, 2


def kill(folder: Path, number: int, after: int, rest_s: float) -> int:
    """Start a recording, kill it some ticks later, and return the tick it was in."""
    ticks = folder / f"{number}.tick"
    ticks.write_bytes(struct.pack("<q", -1))
    child = subprocess.Popen(
        [sys.executable, str(CHILD), str(folder / f"{number}.mcap"), str(ticks), str(number)],
        env=os.environ | {"PYTHONPATH": str(Path.cwd()), "OMP_NUM_THREADS": "1"}, stderr=subprocess.PIPE)
    until = time.monotonic() + 240
    while struct.unpack("<q", ticks.read_bytes())[0] < after and time.monotonic() < until and child.poll() is None:
        time.sleep(0.005)
    time.sleep(rest_s)
    child.send_signal(signal.SIGKILL)
    said = child.communicate()[1].decode()
    assert child.returncode == -signal.SIGKILL, said
    return struct.unpack("<q", ticks.read_bytes())[0]


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """Ten recordings killed at random moments: folder, and the tick that each was in."""
    folder, rng = tmp_path_factory.mktemp("killed"), np.random.default_rng(20260101)
    moments = [(n, int(rng.integers(15, 70)), float(rng.uniform(0, 0.2))) for n in range(KILLS)]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return folder, list(pool.map(lambda moment: kill(folder, *moment), moments))


@pytest.fixture(scope="module")
def recovered(killed):
    return {done.part.name.split(".")[0]: done for done in recover(killed[0])}


def test_at_most_a_quarter_of_a_second_is_lost(killed, recovered):
    lost = [(tick + 1 - recovered[str(number)].frames) / HZ for number, tick in enumerate(killed[1])]
    print(f"\nlost [s], {KILLS} kills: {sorted(round(s, 2) for s in lost)}")
    assert len(recovered) == KILLS
    assert max(lost) <= 0.25


def test_what_is_left_is_whole_and_says_that_it_was_cut_off(recovered):
    for done in recovered.values():
        assert done.kept is not None, done.reason
        episode, trace = read_episode(done.kept)
        assert (episode.outcome.label, episode.frames, len(trace)) == ("unknown", done.frames, done.frames)
        assert np.isfinite(read_frames(done.kept)[1].state).all()
        with done.kept.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            metadata = {m.name: m.metadata for m in reader.iter_metadata()}
            pictures = [m.sequence for _, c, m in reader.iter_messages() if c.topic.startswith("/camera/")]
            assert {"scene.xml", "robot.urdf"} <= {a.name for a in reader.iter_attachments()}
        assert metadata["episode"]["truncated"] == "true"
        assert len(pictures) >= 2, "of both cameras, however busy this machine is"


def test_rerun_opens_what_is_left(recovered):
    from rerun.chunk import McapReader

    done = recovered["0"]
    rows, frames = 0, set[str]()
    for chunk in McapReader(done.kept).stream():
        batch = chunk.to_record_batch()
        if any(name.endswith("Scalars:scalars") for name in batch.schema.names):
            rows += batch.num_rows * (str(chunk.entity_path) == "/joint_states/position")
        frames.update(str(chunk.entity_path).split("/")[2:3] if "/camera/" in str(chunk.entity_path) else ())
    assert (rows, frames) == (done.frames, {"front", "top"})
