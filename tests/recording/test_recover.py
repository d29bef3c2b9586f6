"""What a killed writer left: cut files, killed processes, and things that are no recording."""

import fcntl
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from pipeline.recording import read_attachments, read_episode, recover, write_episode

MANY = 700


@pytest.fixture
def whole(tmp_path, trace, episode, attachments) -> bytes:
    path = tmp_path / "elsewhere" / "a.mcap"
    write_episode(path, episode(MANY), trace(MANY), attachments=attachments,
                  software={"software_commit": "abc", "simulator_version": "mujoco 4.1", "site": "lab-2"})
    data = path.read_bytes()
    path.unlink()
    return data


def test_files_cut_at_random_bytes_keep_their_whole_ticks(tmp_path, whole, trace, episode, attachments):
    rng = np.random.default_rng(3)
    cuts = sorted(int(c) for c in rng.integers(0, len(whole), 25))
    for number, cut in enumerate(cuts):
        (tmp_path / f"{number:02}.mcap.part").write_bytes(whole[:cut])
    found = recover(tmp_path)
    assert [r.part.name for r in found] == [f"{n:02}.mcap.part" for n in range(25)]
    assert list(tmp_path.glob("*.part")) == []
    kept = [r for r in found if r.kept]
    assert len(kept) > 15
    for done, cut in zip(found, cuts, strict=True):
        if done.kept is None:
            assert cut < len(whole) / 5, "only a file without a whole chunk holds nothing to keep"
            continue
        read, back = read_episode(done.kept)
        assert read.frames == done.frames == len(back) > MANY * cut / len(whole) - 250
        assert back.state.tobytes() == trace(MANY).state[: done.frames].tobytes()
        assert read_attachments(done.kept) == attachments
        if done.frames < MANY:
            assert read.outcome.label == "unknown" and "truncated" in read.outcome.reason
            assert done.reason
        else:
            assert read.outcome == episode().outcome.model_copy(update={"tick": MANY - 1})


def test_the_metadata_says_that_it_was_truncated(tmp_path, whole):
    (tmp_path / "a.mcap.part").write_bytes(whole[: len(whole) // 2])
    (done,) = recover(tmp_path)
    with done.kept.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        (record,) = reader.iter_metadata()
        assert reader.get_summary().statistics.channel_message_counts[1] == done.frames
    assert (record.metadata["truncated"], record.metadata["outcome"]) == ("true", "unknown")
    assert record.metadata["software_commit"] == "abc", "who recorded it, not who recovered it"
    assert record.metadata["site"] == "lab-2"


def test_a_file_that_only_missed_its_name_gets_it(tmp_path, whole):
    (tmp_path / "a.mcap.part").write_bytes(whole)
    (done,) = recover(tmp_path)
    assert (done.kept, done.frames, done.reason) == (tmp_path / "a.mcap", MANY, "")
    assert done.kept.read_bytes() == whole


@pytest.mark.parametrize("content", [b"", bytes(5000), b"\x89MCAP0\r\n" + bytes(5000)], ids=["empty", "zeros", "holes"])
def test_what_holds_nothing_is_set_aside_with_its_reason(tmp_path, content):
    (tmp_path / "a.mcap.part").write_bytes(content)
    (done,) = recover(tmp_path)
    assert done.kept is None and done.reason
    assert (tmp_path / "quarantine" / "a.mcap.part").read_bytes() == content
    assert (tmp_path / "quarantine" / "a.mcap.part.reason.txt").read_text() == done.reason + "\n"
    assert recover(tmp_path) == [], "a second start finds nothing to do"


def test_a_finished_file_is_never_replaced(tmp_path, whole):
    (tmp_path / "a.mcap").write_bytes(whole)
    (tmp_path / "a.mcap.part").write_bytes(whole[:-100])
    (done,) = recover(tmp_path)
    assert (tmp_path / "a.mcap").read_bytes() == whole
    assert done.kept is None and "a.mcap is already there" in done.reason


def test_a_file_that_is_being_written_is_left_alone(tmp_path):
    part = tmp_path / "a.mcap.part"
    with part.open("wb") as writer:
        fcntl.flock(writer, fcntl.LOCK_EX)
        assert recover(tmp_path) == []
    assert part.exists()


def test_folders_below_are_searched(tmp_path, whole):
    (tmp_path / "x" / "y").mkdir(parents=True)
    (tmp_path / "x" / "y" / "a.mcap.part").write_bytes(whole)
    assert [r.kept for r in recover(tmp_path)] == [tmp_path / "x" / "y" / "a.mcap"]


WRITER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from conftest import make_episode, make_trace
from pipeline.recording import write_episode
m = 12_000
episode, trace = make_episode(m), make_trace(m)
print("ready", flush=True)
for k in range(10_000):
    write_episode(Path(sys.argv[1]) / f"{k}.mcap", episode, trace, attachments={})
"""


def test_a_writer_killed_in_the_middle_loses_only_what_it_had_not_written(tmp_path, trace):
    parts = list[int]()
    for attempt in range(8):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        child = subprocess.Popen([sys.executable, "-c", WRITER, str(folder), str(Path(__file__).parent)],
                                 stdout=subprocess.PIPE, env=os.environ | {"PYTHONPATH": str(Path.cwd())})
        assert child.stdout and child.stdout.readline() == b"ready\n"
        until = time.monotonic() + 240
        while time.monotonic() < until:
            sizes = [entry.stat().st_size for entry in folder.glob("*.part")]
            if any(size > 500_000 * (attempt + 1) for size in sizes):
                break
        child.send_signal(signal.SIGKILL)
        child.wait()
        child.stdout.close()
        finished = {path: path.read_bytes() for path in folder.glob("*.mcap")}
        left = {path.name: path.stat().st_size for path in folder.glob("*.part")}
        found = recover(folder)
        assert [r.part.name for r in found] == sorted(left)
        assert all(path.read_bytes() == data for path, data in finished.items())
        for done in found:
            assert done.kept is not None, done.reason
            read, back = read_episode(done.kept)
            assert back.sim_state.tobytes() == trace(12_000).sim_state[: read.frames].tobytes()
            parts.append(read.frames)
        if any(n < 12_000 for n in parts):
            return
    pytest.fail(f"no kill hit the middle of a write: {parts}")
