"""Whatever a log or a dataset holds, there is a verdict or one error of ours: never a fault of the checks."""

import json
import random

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from pipeline.check.folder import read_folder
from pipeline.check.initial import from_log
from pipeline.check.load import read_recording
from pipeline.check.run import check
from pipeline.errors import HardcaseError
from schemas.contract import CameraRule, Contract, Limit, Pair, TopicRule

NUMBERS = st.one_of(st.floats(-1e3, 1e3), st.just(1e308), st.just(0.0), st.integers(-5, 2**53))
MESSAGE = st.fixed_dictionaries({"name": st.lists(st.sampled_from("abc"), max_size=3),
                                 "position": st.lists(NUMBERS, max_size=4)},
                                optional={"velocity": st.lists(NUMBERS, max_size=3), "flag": st.booleans(),
                                          "data": st.text(max_size=5), "nested": st.dictionaries(st.text(max_size=3),
                                                                                                 NUMBERS, max_size=2)})
TOPIC = st.lists(st.tuples(st.integers(0, 10**10), MESSAGE), max_size=40)
CONTRACT = Contract(
    topics={"/joint_states": TopicRule(rate_hz=20, max_gap_s=0.1), "/absent": TopicRule()},
    motion=(Pair(measured="/joint_states.position", commanded="/joint_commands.position"),),
    limits={"/joint_states.position": {"a": Limit(low=-1, high=1, speed=1, unit="rad"), "z": Limit(unit="m")}},
    cameras={"/camera/front/image/compressed": CameraRule(fingerprint="7f" * 192)}, consent=False)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(topics=st.dictionaries(st.sampled_from(["/joint_states", "/joint_commands", "odd", "/tf"]), TOPIC, max_size=3),
       even=st.booleans())
def test_any_log_of_json_gets_a_verdict(topics, even, tmp_path):
    path = tmp_path / "any.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, enable_data_crcs=True)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        for name, messages in topics.items():
            channel = writer.register_channel(name, "json", schema)
            for k, (at, message) in enumerate(messages):
                stamp = k * 50_000_000 if even else at
                writer.add_message(channel, stamp, json.dumps(message).encode(), stamp, k)
        writer.finish()
    subject = read_recording(path)
    for contract in (Contract(), CONTRACT):
        verdict = check(subject, contract)
        assert all(f.mend and f.where for f in verdict.findings)
    from_log(subject)


def test_spoiled_bytes_of_a_recording_get_a_verdict_or_one_error(film, drawn, tmp_path):
    data, rng = film(drawn(0)).read_bytes(), random.Random(0)
    for k in range(40):
        spoiled = bytearray(data)
        for _ in range(rng.randint(1, 4)):
            spoiled[rng.randrange(len(spoiled))] ^= 1 << rng.randrange(8)
        path = tmp_path / f"{k}.mcap"
        path.write_bytes(spoiled[:rng.randrange(len(spoiled))] if k % 4 == 0 else spoiled)
        try:
            check(read_recording(path), Contract())
        except HardcaseError as error:
            assert error.mend


@pytest.mark.parametrize("table", ["data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet",
                                   "meta/info.json", "meta/stats.json"])
def test_spoiled_bytes_of_a_dataset_get_a_verdict_or_one_error(table, folder):
    whole, rng = (folder / table).read_bytes(), random.Random(0)
    for _ in range(25):
        spoiled = bytearray(whole)
        for _ in range(rng.randint(1, 3)):
            spoiled[rng.randrange(len(spoiled))] ^= 1 << rng.randrange(8)
        (folder / table).write_bytes(spoiled)
        try:
            check(read_folder(folder), Contract())
        except HardcaseError as error:
            assert error.mend


@pytest.mark.parametrize("change", [
    lambda info: info.update(fps=0), lambda info: info.update(fps="fast"), lambda info: info.update(features=[]),
    lambda info: info["features"]["action"].update(shape=[6]), lambda info: info["features"]["action"].update(names=7),
    lambda info: info.update(splits={"train": "all", "val": 3}), lambda info: info.update(total_frames=None),
    lambda info: info["features"].update({"images.x": {"dtype": "video", "shape": [4, 4, 3], "names": None}}),
    lambda info: info["features"].update({"gone": {"dtype": "float32", "shape": [2], "names": None}}),
], ids=["no rate", "rate in words", "features in a list", "wrong shape", "names that are a number", "odd splits",
        "no total", "no video", "a feature without rows"])
def test_an_odd_description_gets_a_verdict_or_one_error(change, folder, edit_json):
    edit_json(folder / "meta/info.json", change)
    try:
        check(read_folder(folder), Contract())
    except HardcaseError as error:
        assert error.mend


def test_huge_and_empty_values_are_no_fault_of_the_checks(spoil_trace, findings):
    def huge(t):
        t.state[:] = np.where(np.arange(len(t.state))[:, None] % 2, 1e300, -1e300)
        t.action[:] = np.nan

    assert not findings(spoil_trace(huge)).passed
