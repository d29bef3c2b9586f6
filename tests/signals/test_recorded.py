"""Signals in recordings: topics of their own, bit for bit, and no trace of them where nobody watched."""

import dataclasses

import numpy as np
import pytest
from mcap.reader import make_reader

from pipeline.browsing.attempts import of_trace
from pipeline.browsing.blueprint import PLOT_FOLDERS
from pipeline.browsing.outline import outline
from pipeline.check.load import read_recording
from pipeline.check.run import check
from pipeline.errors import RecordingError
from pipeline.recording import read_episode, write_episode
from pipeline.recording.live import LiveRecorder
from schemas.contract import Contract

RISK = {"distance": np.linspace(1, 2, 30), "warning": np.array([np.nan] + [0.25] * 29)}


def topics(path) -> set[str]:
    with path.open("rb") as stream:
        return {c.topic for c in make_reader(stream).get_summary().channels.values()}


@pytest.fixture
def episode(begun):
    first = begun().segments[0].model_copy(update={"stop": 30})
    return begun().model_copy(update={"frames": 30, "segments": (first,)})


def test_they_come_back_bit_for_bit_what_is_unknown_too(tmp_path, episode, trace_with):
    path = tmp_path / "a.mcap"
    write_episode(path, episode, trace_with(**RISK), attachments={}, fsync=False)
    assert {"/signal/distance", "/signal/warning"} <= topics(path)
    found = read_episode(path)[1].signals
    assert [(n, v.tobytes()) for n, v in found.items()] == [(n, v.tobytes()) for n, v in RISK.items()]


def test_where_nobody_watched_there_is_no_topic_and_nothing_is_read(tmp_path, episode, trace_with):
    path = tmp_path / "a.mcap"
    write_episode(path, episode, trace_with(), attachments={}, fsync=False)
    assert not [t for t in topics(path) if t.startswith("/signal/")]
    assert read_episode(path)[1].signals == {}


def test_a_signal_that_misses_ticks_is_refused(tmp_path, episode, trace_with):
    said = r"signals\[distance\] has shape \(29,\)(.|\n)*mend: record one row a tick"
    with pytest.raises(RecordingError, match=said):
        write_episode(tmp_path / "a.mcap", episode, trace_with(distance=np.ones(29)), attachments={})


def test_a_live_recording_holds_them_as_a_batch_does(tmp_path, begun, row):
    path = tmp_path / "a.mcap"
    with LiveRecorder(path, begun(), attachments={}) as recorder:
        for tick in range(20):
            recorder.tick(tick, dataclasses.replace(row(tick), signals={"distance": tick / 2, "warning": np.nan}))
        recorder.close()
    trace = read_episode(path)[1]
    assert trace.signals["distance"].tolist() == [tick / 2 for tick in range(20)]
    assert np.isnan(trace.signals["warning"]).all()
    assert trace.sim_state.tolist() == [[1.0] * 3] * 20


def test_no_check_takes_what_is_not_known_for_a_fault_of_the_robot(tmp_path, begun, row):
    path = tmp_path / "a.mcap"
    with LiveRecorder(path, begun(), attachments={}) as recorder:
        for tick in range(40):
            for candidate in ("a", "b") if tick % 4 == 0 else ():  # two events in one tick, in a rhythm
                recorder.event("shadow", f"{candidate} late", tick=tick)
            recorder.tick(tick, dataclasses.replace(row(tick), signals={"warning": np.nan}))
        recorder.close()
    found = check(read_recording(path), Contract(name="any")).findings
    assert not [f for f in found if f.where.startswith(("/signal/", "/events"))]


def test_the_viewer_has_a_plot_for_each(episode, trace_with):
    shown = of_trace(episode, trace_with(**RISK), {})
    assert np.array_equal(shown.lines["signals/distance/distance"], RISK["distance"])
    assert outline(shown).plots(PLOT_FOLDERS)["signals"] == ["signals/distance", "signals/warning"]
