"""Candidates beside a robot in real time: it never waits for them, and its recording says what became of them."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from flows.teleop.devices import TeleopOrder, open_robot
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.recording import read_episode
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_header import beginning
from pipeline.shadow.limits import Limits
from pipeline.shadow.live import LiveShadow
from pipeline.shadow.riders import Riders
from stages.record import record

pytestmark = pytest.mark.xdist_group("shadow")
TICKS, SPEED = 40, 2.0


@pytest.fixture(scope="module")
def recorded(files, tmp_path_factory):
    """Records the champion in real time; `happens` is called with (tick, process ids) at every tick."""

    def recording(candidates, limits=None, happens=lambda tick, pids: None):
        driven = open_robot(TeleopOrder(robot="twin:3", speed=SPEED), 0)
        scene = driven.scene_of(0, driven.robot.observe(np.arange(1)))
        episode = beginning(id="0123456789abcdef", kind="autonomous", actor="c", origin="deployed", scene=scene,
                            control_hz=20.0, generation=0, policy="c" * 16)
        path = tmp_path_factory.mktemp("live") / "a.mcap"
        with Riders(candidates, limits, patient=False) as riders, LiveRecorder(path, episode, attachments={}) as to:
            riders.ready()
            driven.robot.begin(scene)
            outcome = record(driven.robot, OnnxPolicy(files["good"]), to, seconds=TICKS / 20,
                             show=lambda tick, stamp_ns: happens(tick, riders.pids()),
                             shadow=LiveShadow(riders, driven.robot) if candidates else None)
            to.close(outcome)
            return read_episode(path)[1], riders.states()

    return recording


@pytest.fixture(scope="module")
def alone(recorded):
    return recorded({})[0]


def at(when, what):
    def happens(tick, pids):
        if tick == when and "bad" in pids:
            os.kill(pids["bad"], what)
            while what != signal.SIGCONT and Path(f"/proc/{pids['bad']}/stat").read_text().split()[2] not in "TZX":
                time.sleep(0.001)  # on a busy machine a process takes its time to stop

    return happens


def doze(tick, pids):
    """Asleep from tick 5 to tick 20."""
    for when, what in ((5, signal.SIGSTOP), (20, signal.SIGCONT)):
        at(when, what)(tick, pids)


BROKEN = {
    "crashes": ("other", None, at(5, signal.SIGSEGV), "crashed: its process died (SIGSEGV)", 6),
    "hangs": ("other", Limits(answer_s=0.2), at(5, signal.SIGSTOP), "hung: no answer within 0.2 s", 6),
    "dozes": ("other", None, doze, "", 6),
    "answers NaN": ("nan", None, at(-1, 0), "", 0),
    "is hostile": ("hostile", None, at(-1, 0), "refused: pickle where a model is expected", 0),
}
"""What is wrong -> file, limits, what happens, what is said of it, and from when on nothing is heard of it."""


@pytest.mark.parametrize("wrong", BROKEN)
def test_a_candidate_that_breaks_leaves_the_robots_commands_as_they_were(wrong, recorded, files, alone):
    kind, limits, happens, says, silent = BROKEN[wrong]
    trace, states = recorded({"bad": files[kind]}, limits, happens)
    for name in ("state", "environment", "action", "joint_action", "sim_state", "controller"):
        assert getattr(trace, name).tobytes() == getattr(alone, name).tobytes()
    apart, told = trace.shadows["bad"].disagreement, [e for e in trace.events if e.name == "shadow"]
    stop = 20 if wrong == "dozes" else TICKS
    assert len(apart) == TICKS and np.isnan(apart[silent:stop]).all()
    assert told and told[0].level == 30 and told[0].text.startswith("bad ")
    if says:
        assert states["bad"].startswith(says)
        assert told[-1].text == f"bad {states['bad']}"
    elif wrong == "answers NaN":
        assert states["bad"].endswith("answers not finite")
    else:
        assert int(states["bad"].partition(": ")[2].split()[0]) >= 14, "answers came late while it slept"


def test_what_a_candidate_would_have_sent_stands_beside_what_was_sent(recorded, files):
    trace, _ = recorded({"itself": files["good"], "other": files["other"]})
    itself, other = trace.shadows["itself"], trace.shadows["other"]
    heard = np.isfinite(itself.disagreement)
    assert (itself.disagreement[heard] == 0).all()
    assert np.array_equal(itself.joint_commands[heard], trace.joint_action[heard])
    assert (other.disagreement[np.isfinite(other.disagreement)] > 0).all()
