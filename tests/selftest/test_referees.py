"""Checkers and readers that others wrote, on our recordings: clean on clean ones, failing on faults they can see."""

import json
import subprocess
import sys

import pytest
from rerun.chunk import McapReader
from rosbags.highlevel import AnyReader

from pipeline.selftest.log import Log
from pipeline.selftest.referees import REFEREES, Expected, tracecheck_contract

pytestmark = [pytest.mark.xdist_group("selftest"), pytest.mark.timeout(900)]  # one worker makes the material, once

KINDS = ("demonstrated", "deployed", "corrected", "filmed")
CAMERA = "/camera/front/image/compressed"


@pytest.fixture(scope="module")
def expected(clean):
    """What referees are told of each kind, from a recording that they are not asked about."""
    return {kind: Expected.of(clean[kind][-1]) for kind in KINDS}


@pytest.mark.parametrize("referee", REFEREES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_referee_finds_nothing_in_a_clean_recording(kind, referee, clean, expected):
    assert REFEREES[referee](clean[kind][0], expected[kind]).reasons == ()


def test_tracecheck_looks_at_everything_that_it_can(clean, expected, tmp_path):
    """Its timing checks are skipped where the contract does not say that the clock is known."""
    contract = tmp_path / "contract.json"
    contract.write_text(json.dumps(tracecheck_contract(expected["filmed"])))
    command = [sys.executable, "-m", "tracecheck", "check", str(clean["filmed"][0]), "--contract", str(contract),
               "--out", str(tmp_path / "out"), "--quiet"]
    assert subprocess.run(command, check=False, capture_output=True).returncode == 0
    report = json.loads((tmp_path / "out/report.json").read_text())
    status = {check["id"]: check["status"] for check in report["checks"]}
    assert status.pop("C10") == "skipped"  # an absolute interval, which differs from file to file
    assert set(status.values()) == {"pass"} and len(status) == 9


SEEN = {
    ("gap", "demonstrated"): {"tracecheck": "C07", "baglint": "gap"},
    ("wrong-rate", "demonstrated"): {"tracecheck": "C06", "baglint": "rate_below_min"},
    ("clock-back", "corrected"): {"tracecheck": "C08", "baglint": "stamp_backwards"},
    ("missing-topic", "demonstrated"): {"tracecheck": "C02", "baglint": "missing_topic"},
    ("lost-messages", "demonstrated"): {"tracecheck": "C09"},
    ("exchanged-messages", "deployed"): {"tracecheck": "C09", "baglint": "stamp_backwards"},
    ("truncated", "demonstrated"): {"tracecheck": "C01", "baglint": "refused"},
    ("corrupt-chunk", "deployed"): {"tracecheck": "C01"},
    ("wrong-robot", "demonstrated"): {"tracecheck": "C04"},
    ("missing-camera", "filmed"): {"tracecheck": "C02", "baglint": "missing_topic"},
}


@pytest.mark.parametrize(("fault", "kind"), SEEN, ids=lambda value: value)
def test_a_referee_sees_the_faults_that_are_within_its_reach(fault, kind, tested, expected):
    for referee, code in SEEN[fault, kind].items():
        opinion = REFEREES[referee](tested.planted / fault / "0.mcap", expected[kind])
        assert not opinion.passed and any(reason.startswith(code) for reason in opinion.reasons), (referee, opinion)


def test_rosbags_reads_every_recording(clean):
    for path in [path for paths in clean.values() for path in paths]:
        with AnyReader([path]) as reader:
            count = sum(1 for _ in reader.messages())
            assert count == sum(c.msgcount for c in reader.connections) > 0, path.name
            stated = next(m for m in reader.messages([c for c in reader.connections if c.topic == "/joint_states"]))
            assert len(reader.deserialize(stated[2], "sensor_msgs/msg/JointState").position) == 7


def test_rerun_opens_every_recording_with_its_joints_and_pictures(clean):
    for kind, paths in clean.items():
        for path in paths:
            rows: dict[str, int] = {}
            for chunk in McapReader(path).stream():
                batch = chunk.to_record_batch()
                if any("Scalars" in name or "EncodedImage" in name for name in batch.schema.names):
                    rows[str(chunk.entity_path)] = rows.get(str(chunk.entity_path), 0) + batch.num_rows
            ticks = len(Log.read(path).of("/joint_states"))
            assert rows["/joint_states/position"] == ticks, path.name
            if kind == "filmed":
                assert rows[CAMERA] == ticks, path.name
