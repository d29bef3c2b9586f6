"""`hardcase record` as a person meets it: recorded, killed, recovered; and what it refuses."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from pipeline.recording import read_episode, read_frames

HARDCASE = [sys.executable, "-c", "from flows.cli import main; main()"]


def start(folder: Path, *arguments: str, **env: str) -> subprocess.Popen:
    return subprocess.Popen([*HARDCASE, *arguments], cwd=folder, text=True, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE,
                            env=os.environ | {"PYTHONPATH": str(Path.cwd()), "OMP_NUM_THREADS": "1"} | env)


def run(folder: Path, *arguments: str, **env: str) -> tuple[int, str, str]:
    child = start(folder, *arguments, **env)
    out, err = child.communicate(timeout=240)
    return child.returncode, out, err


def wait_for(path: Path, size: int, child: subprocess.Popen) -> None:
    """Until the recording has begun and holds some ticks."""
    until = time.monotonic() + 240
    while (not path.exists() or path.stat().st_size < size) and child.poll() is None and time.monotonic() < until:
        time.sleep(0.02)


def topics(path: Path) -> set[str]:
    with path.open("rb") as stream:
        return {channel.topic for channel in make_reader(stream, validate_crcs=True).get_summary().channels.values()}


def test_it_records_for_as_long_as_it_was_told_to(tmp_path):
    code, out, err = run(tmp_path, "record", "a.mcap", "--seconds", "1", "--seed", "3", "--json")
    assert (code, err) == (0, "")
    said = json.loads(out)
    episode, frames = read_frames(tmp_path / "a.mcap")
    assert len(frames) == episode.frames == said["episode"]["frames"] == 20
    assert (episode.origin, episode.segments[0].kind, episode.segments[0].actor) == ("scripted", "autonomous", "expert")
    assert (said["dropped"], episode.outcome.label) == ({}, "failure"), "nobody places a cube within a second"


def test_where_nothing_renders_one_line_says_so_and_the_rest_is_recorded(tmp_path):
    code, out, err = run(tmp_path, "record", "a.mcap", "--camera", "front", "--seconds", "0.5", MUJOCO_GL="disabled")
    assert code == 0 and "0.5 s, 10 ticks" in out
    assert err.splitlines() == ["no pictures: rendering is switched off; recording goes on without "
                                "(unset MUJOCO_GL, or set it to egl or osmesa)"]
    assert not any(topic.startswith("/camera/") for topic in topics(tmp_path / "a.mcap"))


def test_ctrl_c_closes_it_whole(tmp_path):
    child = start(tmp_path, "record", "a.mcap", "--seconds", "60")
    wait_for(tmp_path / "a.mcap.part", 50_000, child)
    child.send_signal(signal.SIGINT)
    out, err = child.communicate(timeout=240)
    assert (child.returncode, err) == (130, "")
    episode, _ = read_episode(tmp_path / "a.mcap")
    assert (episode.outcome.label, episode.outcome.reason) == ("unknown", "cut off: interrupted")
    assert "rerun a.mcap" in out


def test_killed_recovered_and_read(tmp_path):
    child = start(tmp_path, "record", "a.mcap", "--camera", "front", "--camera", "top", "--seconds", "60")
    wait_for(tmp_path / "a.mcap.part", 150_000, child)
    child.kill()
    child.communicate()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.part"]
    code, out, _ = run(tmp_path, "recover", ".")
    assert code == 0 and "a.mcap" in out and "never closed" in out
    episode, trace = read_episode(tmp_path / "a.mcap")
    assert episode.outcome.label == "unknown" and len(trace) == episode.frames > 5
    assert (tmp_path / "a.mcap").exists() and not (tmp_path / "a.mcap.part").exists()


@pytest.mark.parametrize(("arguments", "what", "mend"), [
    (("there.mcap",), "recording is already there", "name another file"),
    (("a.bag",), "a recording is named .mcap, not '.bag'", "write to a.mcap"),
    (("a.mcap", "--camera", "side"), "unknown camera 'side'", "use one of: front, top"),
    (("a.mcap", "--robot", "leg"), "unknown robot 'leg'", "use one of: arm"),
    (("a.mcap", "--robot", "lerobot:so101"), "a policy alone does not move a real robot", "hardcase teleop --robot"),
    (("a.mcap", "--policy", "champion"), "there is no store here", "hardcase loop"),
], ids=["taken", "other format", "camera", "robot", "real robot", "store"])
def test_what_it_refuses(tmp_path, arguments, what, mend):
    (tmp_path / "there.mcap").write_bytes(b"")
    code, out, err = run(tmp_path, "record", *arguments, HARDCASE_STORE=str(tmp_path / "store"))
    assert (code, out) == (2, "")
    first, at, last = err.splitlines()
    assert what in first and at.startswith("  at: ") and mend in last
    assert sorted(path.name for path in tmp_path.iterdir()) == ["there.mcap"]
