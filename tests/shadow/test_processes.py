"""Candidates in processes of their own: whatever becomes of them, the champion does to the bit what it did alone."""

import os
import signal
import time

import numpy as np
import pytest

from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.protocols import Observation
from pipeline.shadow.limits import Limits
from pipeline.shadow.riders import Riders

pytestmark = pytest.mark.xdist_group("shadow")
MIB = 1 << 20


def seen(rng: np.random.Generator, n: int) -> Observation:
    return Observation(rng.normal(size=(n, 16)), rng.normal(size=(n, 7)))


def stop(pids):
    os.kill(pids["bad"], signal.SIGSTOP)


def kill(pids):
    os.kill(pids["bad"], signal.SIGKILL)


def segfault(pids):
    os.kill(pids["bad"], signal.SIGSEGV)


BROKEN = {
    "killed": ("other", None, kill, "crashed: its process died (SIGKILL)"),
    "crashes": ("other", None, segfault, "crashed: its process died (SIGSEGV)"),
    "hangs": ("other", Limits(answer_s=1.0), stop, "hung: no answer within 1 s"),
    "is slow": ("busy", Limits(patience_s=0.01), None, "slow: the clock waited 0.01 s for it in 1 ticks"),
    "takes memory": ("hog", Limits(memory_bytes=120 * MIB), None, "crashed: takes more than 120 MiB of memory"),
    "takes the core": ("busy", Limits(cpu_s=1), None, "crashed: takes more than 1 s of CPU time"),
    "is hostile": ("hostile", None, None, "refused: pickle where a model is expected"),
}
"""What is wrong -> file, limits, what happens at tick 5, and what is said of it."""


@pytest.mark.parametrize("wrong", BROKEN)
def test_a_candidate_that_breaks_leaves_the_champions_commands_as_they_were(wrong, work, files, alone, commands):
    kind, limits, happens, says = BROKEN[wrong]
    done = work({"bad": files[kind]}, limits, at=5, happens=happens or (lambda pids: None))
    assert commands(done) == commands(alone)
    assert done.states["bad"].startswith(says)
    for (episode, trace), (single, _) in zip(done.attempts, alone.attempts, strict=True):
        assert episode == single.model_copy(update={"blob": episode.blob})
        told = [e for e in trace.events if e.name == "shadow"]
        assert [(e.level, e.text) for e in told] == [(30, f"bad {done.states['bad']}")]
        apart = trace.shadows["bad"].disagreement
        assert np.isfinite(apart[:told[0].tick]).all() and np.isnan(apart[told[0].tick:]).all()
        assert np.isnan(trace.shadows["bad"].joint_commands).all(axis=1).tolist() == np.isnan(apart).tolist()


def test_a_candidate_that_answers_nan_leaves_the_champions_commands_as_they_were(work, files, alone, commands):
    done = work({"bad": files["nan"]})
    assert commands(done) == commands(alone)
    ticks = sum(len(trace) for _, trace in done.attempts)
    assert done.states == {"bad": f"broken: {ticks} answers not finite"}
    for _, trace in done.attempts:
        assert np.isnan(trace.shadows["bad"].disagreement).all()
        told = [(e.tick, e.text) for e in trace.events if e.name == "shadow"]
        assert told == [(0, "bad broken: 20 answers not finite")]


def test_good_candidates_beside_broken_ones_are_heard_and_the_same_run_gives_the_same_bytes(work, files, alone,
                                                                                           commands):
    one, two = (work({"bad": files["other"], "a": files["good"], "b": files["other"], "evil": files["hostile"]},
                     at=5, happens=kill) for _ in range(2))
    assert [path.read_bytes() for path in one.files] == [path.read_bytes() for path in two.files]
    assert commands(one) == commands(alone)
    assert (one.states["a"], one.states["b"]) == ("running", "running")
    for _, trace in one.attempts:
        assert (trace.shadows["a"].disagreement == 0).all(), "the champion in its own shadow"
        assert np.array_equal(trace.shadows["a"].joint_commands, trace.joint_action)
        assert (trace.shadows["b"].disagreement > 0).all()


def test_answers_are_to_the_bit_what_the_policy_says_in_this_process_however_many_attempts(files):
    rng, n, own = np.random.default_rng(0), 600, OnnxPolicy(files["other"])
    with Riders({"a": files["other"]}, patient=True) as riders:
        for _ in range(2):
            ids = np.arange(n)
            riders.reset(n)
            own.reset(n)
            for _ in range(6):
                ids = ids[rng.random(len(ids)) < 0.8]
                observation = seen(rng, len(ids))
                riders.offer(observation, ids)
                assert riders.answers()["a"].tobytes() == own.act(observation, ids).tobytes()
        assert (riders.states(), list(riders.news())) == ({"a": "running"}, [])


def test_a_candidate_without_a_file_is_refused_with_the_mend(tmp_path):
    with Riders({"a": tmp_path / "none.onnx"}, patient=True) as riders:
        riders.ready()
        assert riders.states()["a"] == ("refused: policy file cannot be read: No such file or directory "
                                        "(mend: export the policy again: hardcase train)")


def test_offers_to_a_candidate_that_sleeps_return_until_it_wakes_and_begins_anew(files):
    rng, ids = np.random.default_rng(0), np.arange(256)
    with Riders({"a": files["other"]}, Limits(answer_s=600), patient=False) as riders:
        riders.ready()
        riders.reset(256)
        os.kill(riders.pids()["a"], signal.SIGSTOP)
        observation, ticks = seen(rng, 256), 0
        while "lost on the way" not in riders.states()["a"]:
            riders.offer(observation, ids)
            assert np.isnan(riders.answers()["a"]).all()
            ticks += 1
        assert [id for id, state in riders.news()] == ["a"] and ticks > 3
        os.kill(riders.pids()["a"], signal.SIGCONT)
        while np.isnan(riders.answers()["a"]).any():  # too late for the tick, and only then it is NaN
            riders.offer(observation, ids)
            time.sleep(0.01)
        assert riders.states()["a"].startswith("running: ") and "late" in riders.states()["a"]
