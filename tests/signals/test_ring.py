"""A ring: full rate around a trigger, one tick in ten elsewhere, and whoever is killed keeps the window."""

import dataclasses
import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import RecordingError
from pipeline.recording import read_episode, recover
from pipeline.recording.ring import RingRecorder
from pipeline.recording.ring_lap import Ring
from schemas.episode import Outcome

CHILD, HZ = Path(__file__).with_name("ring_child.py"), 20.0
RING = Ring(before_s=2.0, after_s=1.0, every=10)
BEFORE, AFTER = 40, 20
SUCCESS = Outcome(label="success", judged_by="sensors")


@pytest.fixture
def ringed(tmp_path, begun, row):
    """Records so many ticks, faster than real time, with triggers; returns the recorder and what `close` gave."""

    def made(ticks: int, *triggers: int):
        recorder = RingRecorder(tmp_path / "shift.mcap", begun(), attachments={"config.json": b"{}"}, ring=RING)
        with recorder:
            for tick in range(ticks):
                if tick in (0, ticks // 2):
                    recorder.phase("reach" if tick == 0 else "carry", tick=tick)
                if tick in triggers:
                    recorder.trigger("stall", "stall in phase reach", tick=tick)
                recorder.tick(tick, row(tick))
                while recorder.opening:  # on a robot's clock there are 500 ms for it
                    time.sleep(0.001)
            return recorder, recorder.close(SUCCESS)

    return made


def ticks_of(path) -> np.ndarray:
    """Which ticks of the shift a file holds: the state of each says so."""
    return read_episode(path)[1].state[:, 0].astype(int)


def test_a_shift_without_a_trigger_leaves_one_tick_in_ten_and_nothing_else(ringed, tmp_path):
    recorder, closed = ringed(400)
    assert ticks_of(closed.path).tolist() == list(range(0, 400, 10))
    assert closed.episode.control_hz == HZ / 10 and closed.episode.outcome == SUCCESS
    assert recorder.windows == [] and [p.name for p in tmp_path.iterdir()] == ["shift.mcap"]


@pytest.mark.parametrize("at", [5, 130, 395], ids=["at the start", "in the middle", "at the end"])
def test_a_window_holds_every_tick_from_before_its_trigger_to_after_it(ringed, at):
    recorder, closed = ringed(400, at)
    (window,) = recorder.windows
    kept = ticks_of(window.path)
    assert kept.tolist() == list(range(kept[0], kept[-1] + 1)), "full rate"
    assert kept[0] <= max(0, at - BEFORE) and kept[-1] >= min(399, at + AFTER)
    outcome = window.episode.outcome
    known = "success" if kept[-1] == 399 else "unknown"  # a part knows how all ended only where it reaches the end
    assert (outcome.label, outcome.trigger, kept[0] + outcome.tick) == (known, "stall", at)
    events = [(e.name, kept[0] + e.tick) for e in read_episode(window.path)[1].events if e.name == "trigger"]
    assert events == [("trigger", at)]
    assert ticks_of(closed.path).tolist() == list(range(0, 400, 10)), "the rest stays, decimated"


def test_triggers_far_apart_have_windows_of_their_own_and_close_ones_share_one(ringed):
    recorder, _ = ringed(600, 100, 110, 400)
    kept = [ticks_of(w.path) for w in recorder.windows]
    assert [(int(k[0]), int(k[-1])) for k in kept] == [(40, 130), (320, 420)], "every 40 ticks a file begins"


def test_a_window_knows_its_phase_and_who_commanded(ringed):
    recorder, _ = ringed(400, 300)
    (window,) = recorder.windows
    episode, trace = read_episode(window.path)
    first = int(trace.state[0, 0])
    assert list(trace.phase) == ["reach" if first + k < 200 else "carry" for k in range(len(trace))]
    assert [s.actor for s in episode.segments] == ["policy"]


def test_pictures_and_takeovers_go_where_their_ticks_go(tmp_path, begun, row):
    picture = np.zeros((8, 8, 3), np.uint8)
    with RingRecorder(tmp_path / "shift.mcap", begun(), attachments={}, ring=RING) as recorder:
        for tick in range(60):
            recorder.image("front", picture, tick=tick)
            if tick == 30:
                recorder.segment("intervention", "operator-1", tick=tick)
                recorder.trigger("take-over", "somebody takes over", tick=tick)
            recorder.tick(tick, dataclasses.replace(row(tick)))
        recorder.close(SUCCESS)
    (window,) = recorder.windows
    segments = [(s.kind, s.start, s.stop) for s in window.episode.segments]
    assert segments == [("autonomous", 0, 30), ("intervention", 30, window.episode.frames)]
    assert dict(recorder.dropped) == {}


def test_a_file_of_that_name_is_not_overwritten(tmp_path, begun):
    (tmp_path / "shift-window-001.mcap").write_bytes(b"kept")
    with pytest.raises(RecordingError, match=r"already there(.|\n)*mend: name another file"):
        RingRecorder(tmp_path / "shift.mcap", begun(), attachments={}, ring=RING)
    assert [p.name for p in tmp_path.iterdir()] == ["shift-window-001.mcap"]


@pytest.mark.parametrize("rest", [30, 190], ids=["soon after", "long after"])
def test_who_is_killed_after_a_trigger_has_the_window(tmp_path, rest):
    ticks, trigger = tmp_path / "ticks", 150
    ticks.write_bytes(struct.pack("<q", -1))
    child = subprocess.Popen([sys.executable, str(CHILD), str(tmp_path / "shift.mcap"), str(ticks), str(trigger)],
                             env=os.environ | {"PYTHONPATH": str(Path.cwd())}, stderr=subprocess.PIPE)
    until = time.monotonic() + 120
    while struct.unpack("<q", ticks.read_bytes())[0] < trigger + rest and time.monotonic() < until:
        assert child.poll() is None, child.communicate()[1].decode()
        time.sleep(0.002)
    child.send_signal(signal.SIGKILL)
    child.communicate()
    last = struct.unpack("<q", ticks.read_bytes())[0]
    made = {done.kept for done in recover(tmp_path) if done.kept is not None}
    windows = [ticks_of(path) for path in made if "window" in path.name]
    kept = min(windows, key=lambda found: found[0])
    assert kept[0] <= trigger - 100, "a second before it, at 100 Hz"
    assert kept.tolist() == list(range(kept[0], kept[-1] + 1))
    assert last - kept[-1] <= 25, "a quarter of a second is lost, as in any recording"
    assert tmp_path / "shift.mcap" in made
