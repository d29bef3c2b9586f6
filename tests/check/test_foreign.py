"""Logs of other people: JSON, odd but legal, without an arm, or not decodable."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from schemas.contract import Contract, Pair, TopicRule

START = 1_700_000_000_000_000_000


@pytest.fixture
def log(tmp_path):
    """Writes a JSON log: topics without a slash, a latched message at time 0, joints and commands at 50 Hz."""

    def write(*, lag: int = 3, n: int = 200, command_scale: float = 1.0, extra: bool = False, late: int = 0) -> Path:
        path = tmp_path / "foreign.mcap"
        t = np.arange(n) / 50
        target = np.stack([np.sin(1.7 * t) + 0.3 * np.sin(5 * t), 0.5 * np.cos(2.3 * t)], axis=1)
        with path.open("wb") as stream:
            writer = Writer(stream, enable_data_crcs=True)
            writer.start(profile="", library="somebody")
            schema = writer.register_schema("arm.State", "jsonschema", json.dumps({"type": "object"}).encode())
            tf, joints, commands = (writer.register_channel(name, "json", schema)
                                    for name in ("tf_static", "joints", "targets"))
            writer.add_message(tf, 0, json.dumps({"frames": 3}).encode(), 0)
            writer.add_message(tf, START, json.dumps({"frames": 3}).encode(), START)
            if extra:
                odd = writer.register_channel("blob", "flatbuffer", 0)
                writer.add_message(odd, START, b"\x00\x01", START)
            for k in range(n):
                at = START + k * 20_000_000
                q, command = target[max(0, k - lag)], command_scale * target[max(0, k - late)]
                for channel, values in ((joints, q), (commands, command)):
                    data = json.dumps({"name": ["a", "b"], "position": values.tolist()}).encode()
                    writer.add_message(channel, at, data, at, k)
            writer.finish()
        return path

    return write


CONTRACT = Contract(
    consent=False, motion=(Pair(measured="joints.position", commanded="targets.position"),),
    topics={"joints": TopicRule(rate_hz=50), "targets": TopicRule(rate_hz=50), "tf_static": TopicRule()})


def test_a_clean_log_of_somebody_else_passes(log, findings):
    verdict = findings(log(), CONTRACT)
    assert verdict.findings == ()
    assert {"rates", "gaps", "lag", "frozen", "finite", "sequence"} <= set(verdict.checks)


def test_without_a_contract_the_clocks_are_checked_and_consent_is_asked_for(log, findings):
    assert [f.check for f in findings(log()).findings] == ["consent"]


def test_a_lag_of_eight_frames_is_found_in_a_foreign_log(log, findings):
    assert findings(log(lag=24), CONTRACT).findings[0].what.startswith("joints.position runs behind targets.position")
    assert findings(log(late=8), CONTRACT).findings[0].what.startswith("joints.position runs ahead of targets.position")


def test_degrees_are_told_by_the_command_alone(log, findings):
    found = [f for f in findings(log(command_scale=180 / np.pi), CONTRACT).findings if f.check == "units"]
    assert found and "a looks like degrees: it moves 57 times as far as in joints.position" in found[0].what


def test_what_cannot_be_decoded_is_counted_and_the_rest_is_checked(log, findings):
    verdict = findings(log(extra=True), CONTRACT)
    assert verdict.passed
    assert [(f.severity, f.where, f.what) for f in verdict.findings] == [
        ("warning", "blob", "1 of 1 messages cannot be decoded")]


def test_a_log_without_an_arm_says_what_it_lacks(log, findings):
    verdict = findings(log(), Contract(consent=False))
    assert verdict.passed
    assert verdict.skipped["lag"] == "no measured signal with its command (motion in the contract)"


def test_an_empty_log_fails(tmp_path, findings):
    path = tmp_path / "empty.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    assert "it holds no message" in [f.what for f in findings(path, CONTRACT).findings]
