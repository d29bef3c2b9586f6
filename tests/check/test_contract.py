"""Contracts: written from good logs, read from YAML, refused in one line."""

import pytest

from pipeline.check.contract import load_contract, urdf_limits
from pipeline.check.initial import from_log, to_yaml
from pipeline.check.load import read_recording
from pipeline.check.signals import Subject
from pipeline.errors import ConfigError
from schemas.contract import Contract


@pytest.fixture(scope="module")
def written(demos) -> Contract:
    """A contract from three good logs."""
    subjects = [read_recording(path) for path in demos[:3]]
    return from_log(Subject("three", subjects[0].digest, tuple(s.recordings[0] for s in subjects)), name="arm")


def test_good_logs_keep_a_contract_that_was_written_from_other_good_logs(written, demos, findings):
    for path in demos:
        verdict = findings(path, written)
        assert verdict.findings == () and {"rates", "coverage", "limits", "evaluation"} <= set(verdict.checks)


def test_a_written_contract_names_rates_topics_limits_and_the_task(written):
    assert written.topics["/joint_states"].rate_hz == 20
    assert written.topics["/joint_states"].max_gap_s == pytest.approx(0.25)
    assert not written.topics["/reward/reach"].required
    assert written.limits["/joint_states.position"]["joint1"].high == 2.4  # the URDF's, not what was seen
    assert 0.08 < written.limits["/joint_states.position"]["gripper"].high < 0.1
    assert written.evaluation.task == "pick-place" and written.evaluation.control_hz == 20


def test_a_written_contract_reads_back_as_it_was(written, tmp_path):
    file = tmp_path / "contract.yaml"
    file.write_text(to_yaml(written))
    assert load_contract(file) == written


def test_speeds_beyond_the_contract_are_found(written, spoil_trace, findings):
    def fast(t):
        t.state[20:, 5] += 0.8

    found = [f for f in findings(spoil_trace(fast), written).findings if f.check == "limits"]
    assert any("joint6 moves at" in f.what and "rad/s" in f.what for f in found)


def test_another_task_than_the_contracts_is_found(written, demos, findings):
    other = written.model_copy(update={"evaluation": written.evaluation.model_copy(update={"task": "stack"})})
    found = [f.what for f in findings(demos[0], other).findings]
    assert found == ["the task is pick-place, the evaluation has stack"]


def test_a_topic_of_another_type_is_found(written, demos, findings):
    rule = written.topics["/joint_states"].model_copy(update={"type": "sensor_msgs/Imu"})
    other = written.model_copy(update={"topics": {**written.topics, "/joint_states": rule}})
    assert [f.what for f in findings(demos[0], other).findings] == [
        "type is sensor_msgs/msg/JointState, the contract asks for sensor_msgs/Imu"]


def test_consent_can_be_waived_for_a_robot_that_nobody_can_be_seen_in(spoil_trace, findings):
    def nobody_asked(t):
        t.episode = t.episode.model_copy(update={"consent": "none"})

    path = spoil_trace(nobody_asked)
    assert not findings(path).passed
    assert findings(path, Contract(consent=False)).passed


@pytest.mark.parametrize(("text", "what", "mend"), [
    ("rates: {}", "unknown key 'rates'", "use one of: cameras, consent"),
    ("topics: {/a: {rate_hz: -5}}", "rate_hz = -5: input should be greater than 0", "hardcase check LOG --init"),
    ("limits: {/a.b: {j: {low: 2, high: 1}}}", "low 2.0 is not below high 1.0", "hardcase check LOG --init"),
    ("- 1", "a contract is a mapping, this is list", "hardcase check LOG --init"),
    ("a: [", "not YAML", "hardcase check LOG --init"),
], ids=["typo", "negative rate", "low above high", "list", "no YAML"])
def test_a_wrong_contract_is_refused_with_field_value_and_rule(text, what, mend, tmp_path):
    file = tmp_path / "contract.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError) as refused:
        load_contract(file)
    assert what in refused.value.what and mend in refused.value.mend


def test_limits_come_from_the_urdf_and_a_document_type_is_not_read():
    urdf = b'<robot><joint name="j" type="revolute"><limit lower="-1" upper="2" velocity="3"/></joint></robot>'
    limit = urdf_limits(urdf)["j"]
    assert (limit.low, limit.high, limit.speed, limit.unit) == (-1, 2, 3, "rad")
    assert urdf_limits(b'<!DOCTYPE r [<!ENTITY a "b">]>' + urdf) == {}
    assert urdf_limits(b"not xml") == {}
