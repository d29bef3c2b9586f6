"""Each check of a recording beside one that violates it, and the clean ones that do not."""

import re
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from pipeline.recording.records import Op
from schemas.consent import NO_CONSENT

JOINTS = slice(0, 6)


def test_clean_demonstrations_raise_no_finding(demos, findings):
    for path in demos:
        verdict = findings(path)
        assert verdict.findings == ()
        assert {"rates", "gaps", "lag", "frozen", "units", "success-flag"} <= set(verdict.checks)


def test_what_could_not_be_checked_is_named_with_what_it_lacked(demos, findings):
    skipped = findings(demos[0]).skipped
    assert skipped["frozen-camera"] == "there is no camera"
    assert skipped["statistics"] == "it is no dataset"


def frozen(t):
    joint = int(np.ptp(t.joint_action[:, JOINTS], axis=0).argmax())
    t.state[10:, joint] = t.state[10, joint]


def late_action(t):
    t.action[8:], t.joint_action[8:] = t.action[:-8].copy(), t.joint_action[:-8].copy()
    t.joint_action[:8] = t.joint_action[0]


def early_action(t):
    t.action[:-8], t.joint_action[:-8] = t.action[8:].copy(), t.joint_action[8:].copy()


def late_command_only(t):
    t.action[8:] = t.action[:-8].copy()


def nan(t):
    t.state[17, 2] = np.nan


def infinite_action(t):
    t.action[5, 0] = np.inf


def spike(t):
    t.state[25, 1] += 0.4


def beyond_limit(t):
    t.state[:, 0] += 3.0


def degrees(t):
    t.state[:, JOINTS] *= 180 / np.pi


def degrees_commanded(t):
    t.joint_action[:, JOINTS] *= 180 / np.pi


def millimetres(t):
    t.environment[:, [0, 1, 2, 4, 5, 6]] *= 1000


def wrong_flag(t):
    t.episode = t.episode.model_copy(update={"outcome": t.episode.outcome.model_copy(update={"label": "failure"})})


def missed(t):
    t.environment[:, 4] += 0.2


def held(t):
    t.state[-4:, 6] = 0.04


def lifted(t):
    t.environment[-4:, 2] += 0.05
    t.state[-4:, 9] += 0.1  # the hand as well, and away from it


def no_consent(t):
    t.episode = t.episode.model_copy(update={"consent": NO_CONSENT})


def person_as_simulated(t):
    t.episode = t.episode.model_copy(update={"origin": "teleop"})


@pytest.mark.parametrize(("change", "check", "says"), [
    (frozen, "frozen", "stands still for"),
    (late_action, "lag", r"runs ahead of /joint_commands.position by 0.3\d* s \(\d frames\)"),
    (early_action, "lag", r"runs behind /joint_commands.position by 0.4\d* s \(9 frames\)"),
    (late_command_only, "lag", "runs ahead of /command/ee.data"),
    (nan, "finite", "joint3 is NaN at frame 17"),
    (infinite_action, "finite", "dx is infinite at frame 5"),
    (spike, "spikes", "joint2 jumps by 0.3"),
    (beyond_limit, "limits", "its limit 2.4"),
    (degrees, "units", "joint3 looks like degrees"),
    (degrees_commanded, "units", "joint3 looks like degrees"),
    (millimetres, "units", "object_x looks like millimetres"),
    (wrong_flag, "success-flag", "recorded as failure, but the object lies on its mark, let go"),
    (missed, "success-flag", "recorded as success, but the object ends"),
    (held, "success-flag", "recorded as success, but the hand has not let go of the object"),
    (lifted, "success-flag", "recorded as success, but the object ends 50 mm above where it lay"),
    (no_consent, "consent", "no consent record is named"),
    (person_as_simulated, "consent", "a person commands the robot"),
], ids=lambda value: value.__name__ if callable(value) else None)
def test_a_spoiled_trace_is_found(change, check, says, spoil_trace, findings):
    verdict = findings(spoil_trace(change))
    found = [f for f in verdict.findings if f.check == check]
    assert not verdict.passed and found
    assert any(re.search(says, f.what) for f in found), [f.what for f in found]
    assert all(f.mend for f in found)


def shift(message, seconds):
    message.log_time += int(seconds * 1e9)
    message.publish_time += int(seconds * 1e9)
    return [message]


@pytest.fixture
def changes(at_s):
    """Fault -> what becomes of each message."""
    rng = np.random.default_rng(0)
    return {
        "half a second is missing": lambda topic, m: [] if 1.0 <= at_s(m) < 1.5 else [m],
        "half a second of one topic is missing":
            lambda topic, m: [] if topic == "/joint_states" and 1.0 <= at_s(m) < 1.5 else [m],
        "one message is missing": lambda topic, m: [] if topic == "/joint_states" and m.sequence == 12 else [m],
        "one message is there twice": lambda topic, m: [m, m] if topic == "/command/ee" and m.sequence == 12 else [m],
        "half the rate": lambda topic, m: [m] if m.sequence % 2 == 0 else [],
        "a required topic is missing": lambda topic, m: [] if topic == "/joint_commands" else [m],
        "a topic ends early": lambda topic, m: [] if topic == "/joint_states" and m.sequence > 30 else [m],
        "uneven": lambda topic, m: shift(m, rng.uniform(0, 0.045)),
        "the clock jumps by an hour": lambda topic, m: shift(m, 3600 if at_s(m) > 1 else 0),
        "the clock jumps by a second": lambda topic, m: shift(m, 1 if at_s(m) > 1 else 0),
        "the clock goes back an hour": lambda topic, m: shift(m, -3600 if at_s(m) > 1 else 0),
        "a clock is off": lambda topic, m: shift(m, 0.4 if topic == "/joint_states" else 0),
        "a clock drifts": lambda topic, m: shift(m, 0.05 * at_s(m) if topic == "/joint_states" else 0),
    }


@pytest.mark.parametrize(("fault", "check", "says"), [
    ("half a second is missing", "gaps", "silent for 0.55 s by its log stamps"),
    ("half a second of one topic is missing", "gaps", "silent for 0.55 s by its log stamps"),
    ("one message is missing", "sequence", "1 of 4. messages are missing by their sequence numbers"),
    ("one message is missing", "frames", "4. messages for 4. ticks"),
    ("one message is there twice", "sequence", "1 messages are there twice, the first is number 12"),
    ("half the rate", "rates", "10 messages a second, 20 are expected"),
    ("a required topic is missing", "coverage", "topic /joint_commands, required by contract 'default', is missing"),
    ("a topic ends early", "coverage", "ends .* s early"),
    ("uneven", "jitter", "intervals of .* are off by"),
    ("the clock jumps by an hour", "clock-jump", r"jumps by \+3600 s at message 21, and none is missing"),
    ("the clock jumps by a second", "clock-jump", r"log time and stamps part by \+1 s at message 21"),
    ("the clock goes back an hour", "clock-jump", "goes back 3.6e\\+03 s at message 21"),
    ("a clock is off", "clock-offset", "stamps lie \\+0.4 s off those of the other topics"),
    ("a clock drifts", "clock-drift", r"its clock drifts \+0.1\d* s"),
])
def test_spoiled_messages_are_found(fault, check, says, changes, spoil_messages, findings):
    verdict = findings(spoil_messages(changes[fault]))
    found = [f.what for f in verdict.findings if f.check == check]
    assert not verdict.passed
    assert any(re.search(says, what) for what in found), [f.line() for f in verdict.findings]


def test_a_recording_that_was_cut_off_is_found_and_told_with_what_is_left(demos, findings, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(demos[0].read_bytes()[:-40_000])
    verdict = findings(cut)
    assert "truncated" in {f.check for f in verdict.findings}
    assert "ends early after message" in next(f.what for f in verdict.findings if f.check == "truncated")


def test_a_summary_that_lies_is_found(demos, findings, tmp_path):
    data = bytearray(demos[0].read_bytes())
    start, _, _ = struct.unpack_from("<QQI", data, len(data) - 28)
    at = start
    while data[at] != Op.STATISTICS:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    struct.pack_into("<Q", data, at + 9, 5)
    struct.pack_into("<I", data, len(data) - 12, zlib.crc32(bytes(data[start:-12])))
    lying = tmp_path / "lying.mcap"
    lying.write_bytes(data)
    assert "summary lists 5 messages" in next(f.what for f in findings(lying).findings if f.check == "summary")


def test_a_finding_says_when_and_by_how_much(spoil_messages, changes, findings):
    gap = next(f for f in findings(spoil_messages(changes["half a second is missing"])).findings if f.check == "gaps")
    assert (gap.where, gap.at_s, gap.frame) == ("/joint_states", 0.95, 19)
    assert gap.value == pytest.approx(0.55) and gap.limit == pytest.approx(0.25)


def test_the_verdict_follows_from_file_and_contract_alone(demos, findings, tmp_path):
    copy = tmp_path / Path(demos[0]).name
    copy.write_bytes(demos[0].read_bytes())
    assert findings(copy) == findings(demos[0])


def test_a_finger_that_does_what_its_command_does_is_no_spike(spoil_trace, findings):
    """Its command flaps for one tick, a while after it had been high; the finger follows two ticks later."""
    def flapping(t):
        opening = np.zeros(len(t.state))
        opening[:11] = opening[16] = 0.08
        t.joint_action[:, 6] = opening
        t.state[:, 6] = np.concatenate([[0.08, 0.08], opening[:-2]])

    assert "spikes" not in {f.check for f in findings(spoil_trace(flapping)).findings}
