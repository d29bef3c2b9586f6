"""Disks that are full, slow or gone: told once, never silent, and what was written stays."""

import errno
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from pipeline.errors import RecordingError
from pipeline.recording import read_episode, read_frames, recover
from pipeline.recording.live import LiveRecorder

PICTURE = np.zeros((100, 100, 3), np.uint8)


@pytest.fixture
def crowded(tmp_path, trace, start, row):
    """300 ticks with pictures at once into a queue for a few dozen, then 20 more in peace."""
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}, queue_bytes=400_000) as recorder:
        taken, lived = [], trace(320)
        for tick in range(320):
            recorder.image("front", PICTURE, tick=tick)
            taken.append(recorder.tick(tick, row(lived, tick)))
            if tick == 300:
                time.sleep(0.4)
        return taken, recorder.close()


def test_what_finds_the_queue_full_is_counted_everywhere(crowded):
    taken, closed = crowded
    lost = taken.count(False)
    assert lost > 10 and closed.dropped["tick"] == lost
    assert closed.dropped["/camera/front/image/compressed"] > 100
    assert closed.episode.frames == 320
    with closed.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        events = [m.data for _, c, m in reader.iter_messages() if c.topic == "/events"]
        said = next(m.metadata["dropped"] for m in reader.iter_metadata() if m.name == "episode")
    assert any(f"{lost} messages on tick dropped: the disk is slower than the robot".encode() in e for e in events)
    assert f'"tick": {lost}' in said


def test_a_gap_is_an_error_or_a_truncation_but_never_a_shift(crowded, trace):
    taken, closed = crowded
    first = taken.index(False)
    with pytest.raises(RecordingError, match=rf"skips to tick \d+ at message {first}\n.*\n.*mend: .*--accept-trunc"):
        read_frames(closed.path)
    episode, back = read_episode(closed.path, accept_truncated=True)
    assert (episode.frames, episode.outcome.label) == (first, "unknown")
    assert f"skips to tick {taken.index(True, first)} at message {first}" in episode.outcome.reason
    assert back.state.tobytes() == trace(320).state[:first].tobytes()


def test_pictures_give_way_before_the_robot_does(tmp_path, trace, start, row):
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}, queue_bytes=400_000) as recorder:
        pictures = [recorder.image("front", PICTURE, tick=0) for _ in range(30)]
        assert not all(pictures)
        assert all(recorder.tick(tick, row(trace(), tick)) for tick in range(10))
        recorder.close()


def test_the_disk_is_told_to_keep_what_it_has_while_the_recording_goes_on(tmp_path, trace, start, row):
    """The .part is a pipe, which takes every write and cannot be synced: only who syncs hears of it."""
    os.mkfifo(tmp_path / "a.mcap.part")
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}, reserve_bytes=0) as recorder:
        recorder.tick(0, row(trace(), 0))
        end = time.monotonic() + 240
        while not recorder.failed and time.monotonic() < end:
            time.sleep(0.05)
        with pytest.raises(RecordingError, match=r"recording stopped: Invalid argument[\s\S]*hardcase recover"):
            recorder.close()


def test_the_control_thread_does_not_wait_for_a_disk_that_hangs(tmp_path, trace, start, row):
    """The .part is a pipe that nobody reads: a write into it hangs once 64 KiB are in it."""
    os.mkfifo(tmp_path / "a.mcap.part")
    reader = os.open(tmp_path / "a.mcap.part", os.O_RDONLY | os.O_NONBLOCK)
    recorder = LiveRecorder(tmp_path / "a.mcap", start(), attachments={}, queue_bytes=300_000)
    lived = trace(1000)  # far more than pipe, writer and queue can hold together, however late the writer wakes
    for tick in range(1000):  # a call that waited for the disk would never come back
        recorder.tick(tick, row(lived, tick))
        time.sleep(0.0005)
    assert recorder.dropped["tick"] > 0
    assert not recorder.failed, "a disk that hangs has not failed yet"
    os.set_blocking(reader, True)  # let it go on, so that its threads end
    drain = threading.Thread(target=lambda: [None for _ in iter(lambda: os.read(reader, 1 << 20), b"")], daemon=True)
    drain.start()
    recorder.abandon()
    drain.join()


LIMITED = """
import resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from conftest import Row, beginning, make_episode, make_trace
from pipeline.errors import HardcaseError
from pipeline.recording.live import LiveRecorder
import time
trace, episode = make_trace(600), make_episode()
resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))
start = beginning(id=episode.id, origin="scripted", scene=episode.scene, control_hz=20.0, generation=0, actor="expert")
recorder = LiveRecorder(Path(sys.argv[1]) / "a.mcap", start, attachments={})
refused = None
for k in range(600):
    row = Row(trace.state[k], trace.environment[k], trace.action[k], trace.joint_action[k],
              sim_state=trace.sim_state[k], controller=trace.controller[k])
    if not recorder.tick(k, row):
        refused = k
        break
    time.sleep(0.002)
assert refused and recorder.failed and not recorder.tick(refused + 1, row), "later calls are refused at once"
try:
    recorder.close()
except HardcaseError as error:
    print(refused, type(error.__cause__ or error.__context__).__name__)
    print(error)
"""


def test_a_disk_that_fills_up_is_latched_and_what_was_written_is_kept(tmp_path, trace):
    done = subprocess.run([sys.executable, "-c", LIMITED, str(tmp_path), str(Path(__file__).parent)],
                          capture_output=True, text=True, check=True, env=os.environ | {"PYTHONPATH": str(Path.cwd())})
    first, what, _, mend = done.stdout.splitlines()
    assert what == f"recording stopped: {os.strerror(errno.EFBIG)}"
    assert f"hardcase recover {tmp_path}" in mend
    assert not (tmp_path / "a.mcap").exists()
    (found,) = recover(tmp_path)
    episode, back = read_episode(found.kept)
    assert 50 < episode.frames < int(first.split()[0])
    assert back.state.tobytes() == trace(600).state[: episode.frames].tobytes()


def test_a_full_disk_shows_at_the_start(tmp_path, start):
    (tmp_path / "a.mcap.part").symlink_to("/dev/full")  # the kernel's own full disk
    with pytest.raises(RecordingError, match=r"No space left on device\n.*\n  mend: free space"):
        LiveRecorder(tmp_path / "a.mcap", start(), attachments={})
    assert list(tmp_path.iterdir()) == []


def test_no_recording_starts_below_the_reserve(tmp_path, start):
    with pytest.raises(RecordingError, match=r"MiB free, .* must leave \d+ MiB\n.*\n  mend: free space"):
        LiveRecorder(tmp_path / "a.mcap", start(), attachments={}, reserve_bytes=1 << 60)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("at", [0.1, 0.5, 0.9])
def test_a_file_that_the_disk_changed_does_not_get_its_name(tmp_path, trace, start, row, attachments, at):
    """A bit flips in what was written already; close reads all of it again."""
    path, part = tmp_path / "a.mcap", tmp_path / "a.mcap.part"
    with LiveRecorder(path, start(), attachments=attachments) as recorder:
        for tick in range(60):
            recorder.tick(tick, row(trace(), tick))
        time.sleep(0.4)
        data = bytearray(part.read_bytes())
        place = int(len(data) * at)
        with part.open("r+b") as stream:
            stream.seek(place)
            stream.write(bytes([data[place] ^ 1]))
        with pytest.raises(RecordingError, match=r"CRC mismatch|is damaged|does not read back"):
            recorder.close()
    assert not path.exists() and part.exists()
