"""Live recordings of a busy machine: what was late without harm is told, what was lost is not let pass."""


import numpy as np
import pytest

from pipeline.recording.dialect import EPOCH_NS
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_rows import Row
from pipeline.recording.read import read_attachments, read_episode

STALLED_NS = 800_000_000


@pytest.fixture
def live(demos, drawn, tmp_path):
    """Records the first demonstration live, in a loop that stalls at tick 20; its pictures arrive 10 ticks late."""

    def recorded(*, simulated=True, stall_ns=STALLED_NS, skip=(), told=0, jump_ns=0, slower=1):
        episode, trace = read_episode(demos[0])
        pictures, now = drawn(0), [EPOCH_NS]
        path = tmp_path / "live.mcap"
        recorder = LiveRecorder(path, episode.model_copy(update={"blob": None}), clock=lambda: now[0], reserve_bytes=0,
                                attachments=read_attachments(demos[0]))
        stamps = [EPOCH_NS + slower * round(t * 1e9 / trace.hz) + (stall_ns if t > 20 else 0)
                  for t in range(len(trace))]
        for t, stamp in enumerate(stamps):
            row = Row(trace.state[t], trace.environment[t], trace.action[t], trace.joint_action[t],
                      sim_state=trace.sim_state[t] if simulated else np.zeros(0),
                      controller=trace.controller[t] if simulated else np.zeros(0))
            done = stamps[t + 1] if t + 1 < len(stamps) else stamp + 50_000_000
            now[0] = done - 1_000_000 + (jump_ns if t > 30 else 0)
            recorder.tick(t, row, stamp_ns=stamp)
            late = t - 10
            if late >= 0 and late not in skip:
                recorder.image("front", pictures["front"][late], tick=late, stamp_ns=stamps[late])
        for late in range(len(stamps) - 10, len(stamps)):
            recorder.image("front", pictures["front"][late], tick=late, stamp_ns=stamps[late])
        recorder.skipped("front", told)
        return recorder.close(episode.outcome, episode.segments).path

    return recorded


def severities(verdict):
    return {(f.check, f.severity) for f in verdict.findings}


def test_a_simulated_robot_that_stood_still_meanwhile_is_only_told_so(live, findings):
    verdict = findings(live())
    assert verdict.passed, verdict.findings
    told = " ".join(f.what for f in verdict.findings)
    assert "late at 1 of" in told and "by 0.8 s at most" in told and "pictures arrived up to 0.5" in told


def test_slow_motion_is_no_fault(live, findings):
    assert findings(live(stall_ns=0, slower=3)).passed


def test_a_real_robot_moves_on_while_its_loop_stalls(live, findings):
    assert ("gaps", "error") in severities(findings(live(simulated=False)))


def test_a_recorders_clock_that_jumps_is_found_all_the_same(live, findings):
    assert ("clock-jump", "error") in severities(findings(live(jump_ns=2_000_000_000)))


@pytest.mark.parametrize(("skip", "told", "passes"), [
    ((25, 26, 27), 3, True), ((25, 26, 27), 0, False), (range(15, 30), 15, False)], ids=["few", "untold", "many"])
def test_pictures_that_the_recorder_counted_itself_may_be_missing_a_few_at_a_time(live, findings, skip, told, passes):
    verdict = findings(live(skip=skip, told=told))
    assert verdict.passed == passes
    found = next(f for f in verdict.findings if f.check == "frames" and "missing" in f.what)
    assert found.what.startswith(f"{len(skip)} of ")
    assert ("as the recorder counted" in found.what) == (told > 0)
