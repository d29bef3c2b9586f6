"""Candidates beside a legged robot: whatever becomes of them, the champion does to the bit what it did alone."""

import os
import signal

import numpy as np
import pytest

pytestmark = pytest.mark.xdist_group("shadow")
NAMES = ("state", "action", "joint_action", "sim_state", "controller")


def commands(work):
    return [{name: getattr(trace, name).tobytes() for name in NAMES} for _, trace in work.attempts]


def kill(pids):
    os.kill(pids["bad"], signal.SIGKILL)


def test_a_candidate_that_crashes_leaves_the_champion_as_it_was_and_the_others_are_heard(work, files, alone):
    done = work({"bad": files["other"], "same": files["champion"], "other": files["other"]}, at=5, happens=kill)
    assert commands(done) == commands(alone)
    assert done.states["bad"] == "crashed: its process died (SIGKILL)"
    assert (done.states["same"], done.states["other"]) == ("running", "running")
    for _, trace in done.attempts:
        assert np.isfinite(trace.shadows["bad"].disagreement[:5]).all()
        assert np.isnan(trace.shadows["bad"].disagreement[5:]).all()
        assert not trace.shadows["same"].disagreement.any()
        assert np.array_equal(trace.shadows["same"].joint_commands, trace.joint_action)
        assert (trace.shadows["other"].disagreement > 0).all()
        assert [e.text for e in trace.events if e.name == "shadow"] == ["bad crashed: its process died (SIGKILL)"]


@pytest.mark.parametrize(("kind", "says"), [
    ("wider", "refused: the policy takes 41 values, the robot senses 39"), ("hostile", "refused: pickle"),
    ("nan", "")], ids=["of another robot", "hostile", "not a number"])
def test_a_candidate_that_cannot_ride_says_why(work, files, alone, kind, says):
    done = work({"bad": files[kind]})
    assert commands(done) == commands(alone)
    assert done.states["bad"].startswith(says) and done.states["bad"] != "running"
    assert all(np.isnan(trace.shadows["bad"].disagreement).all() for _, trace in done.attempts)
