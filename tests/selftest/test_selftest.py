"""The checks against known faults: all are caught, nothing clean is accused; and the self-test itself can fail."""

from dataclasses import replace
from pathlib import Path

import pytest

from flows.selftest.catching import exit_code, judge_with, run_selftest
from flows.selftest.display import told
from pipeline.check.table import CHECKS
from pipeline.errors import ConfigError
from pipeline.selftest.dataset_referees import DATASET_REFEREES, news, unexpected
from pipeline.selftest.judging import run
from pipeline.selftest.log import Log
from pipeline.selftest.material import REFUSED, Material
from pipeline.selftest.opinions import Asked, Opinion
from pipeline.selftest.table import FAULTS
from schemas.contract import Contract

pytestmark = [pytest.mark.xdist_group("selftest"), pytest.mark.timeout(900)]  # one worker makes the material, once

ROOT = Path(__file__).parents[2]


def test_every_fault_is_caught(tested):
    missed = [f"{f['name']}: {f['said']}" for f in tested.told["faults"] if not f["caught_by"]]
    assert not missed and len(tested.told["faults"]) == len(FAULTS) >= 25
    assert all(set(f["caught_by"]) <= set(f["expected"]) for f in tested.told["faults"])


def test_nothing_clean_is_accused(tested):
    assert tested.told["alarms"] == []
    assert (tested.told["clean_episodes"], tested.told["false_alarms"], tested.code) == (100, 0, 0)


def test_it_says_what_caught_what(tested):
    line = next(line for line in tested.text.splitlines() if line.startswith("gap "))
    assert line.split()[:2] == ["gap", "gaps"] and "silent for 0.5" in line
    assert f"{len(FAULTS)} of {len(FAULTS)} faults caught" in tested.text


def test_every_check_has_a_fault_that_it_is_meant_for():
    assert {*CHECKS, REFUSED} == {check for fault in FAULTS.values() for check in fault.expect}


@pytest.fixture
def few(clean) -> Material:
    """Five clean recordings, checked by what they say of themselves."""
    return Material({"demonstrated": tuple(clean["demonstrated"][:5])}, {"demonstrated": Contract()}, rendered=True)


@pytest.mark.parametrize("name", ["frozen-joint", "duplicate", "truncated"])
def test_a_fault_is_missed_where_its_check_does_not_take_part(name, few, tmp_path):
    faults = {name: FAULTS[name]}
    whole = run(few, faults, judge_with(CHECKS), tmp_path / "whole", seed=3)
    assert whole.passed and exit_code(whole) == 0
    reduced = judge_with(CHECKS.keys() - set(FAULTS[name].expect))
    without = run(few, faults, reduced, tmp_path / "without", seed=3)
    assert [p.name for p in without.missed] == [name] and exit_code(without) == 1
    assert any(line.split()[:2] == [name, "MISSED"] for line in told(without, None))


def test_a_clean_episode_that_is_not_clean_is_an_alarm(few, tested, tmp_path):
    spoiled = Material({"demonstrated": (*few.clean["demonstrated"], tested.planted / "spike/0.mcap")},
                       few.contracts, rendered=True)
    result = run(spoiled, {}, judge_with(CHECKS), tmp_path, seed=0)
    assert {a.where.parent.name for a in result.alarms} == {"spike"} and exit_code(result) == 1
    assert any(line.startswith("FALSE ALARM  spike/0.mcap: spikes: ") for line in told(result, None))


def test_a_fault_that_the_clean_file_has_already_is_not_counted_as_caught(tested, tmp_path):
    """Otherwise a check that always shouts would pass."""
    spiky = tested.planted / "spike/0.mcap"
    material = Material({"succeeded": (spiky,)}, {"succeeded": Contract()}, rendered=True)
    result = run(material, {"spike": FAULTS["spike"]}, judge_with(CHECKS), tmp_path, seed=0)
    assert [p.name for p in result.missed] == ["spike"]


@pytest.mark.parametrize(("name", "changed"), [
    ("frozen-joint", {"/joint_states"}), ("action-lag", {"/joint_commands", "/command/ee"}),
    ("degrees-state", {"/joint_states"}), ("clock-drift", {"/joint_states"}),
    ("black-camera", {"/camera/front/image/compressed", "/camera/top/image/compressed"}), ("false-failure", set()),
])
def test_a_fault_changes_what_it_says_and_nothing_else(name, changed, tested):
    planted = Log.read(tested.planted / name / "0.mcap")
    source = Log.read(next(tested.clean.rglob(f"{planted.episode.id}.mcap")))
    assert [c.topic for c in planted.channels.values()] == [c.topic for c in source.channels.values()]
    other = {source.topic(a) for a, b in zip(source.messages, planted.messages, strict=True)
             if (a.data, a.log_time, a.publish_time, a.sequence) != (b.data, b.log_time, b.publish_time, b.sequence)}
    assert other <= changed and bool(other) == bool(changed)


def test_the_same_seed_plants_the_same(few, tmp_path):
    spike = {"spike": FAULTS["spike"]._replace(on="demonstrated")}
    for folder in ("one", "two"):
        run(few, spike, judge_with(["spikes"]), tmp_path / folder, seed=5)
    files = [sorted((tmp_path / folder / "spike").glob("*")) for folder in ("one", "two")]
    assert [f.read_bytes() for f in files[0]] == [f.read_bytes() for f in files[1]]


def test_referees_stand_in_columns_of_their_own_and_remarks_in_parentheses(few, tested, tmp_path):
    """And what one of them finds wrong with clean material fails the self-test."""
    result = run(few, {"spike": FAULTS["spike"]._replace(on="demonstrated")}, judge_with(["spikes"]), tmp_path, seed=5)
    spike = result.planted[0]
    both = replace(result, planted=(spike, replace(spike, name="in-rows", fault=spike.fault._replace(on="dataset"))))
    quiet, loud = Opinion(True, ()), Opinion(False, ("C07 gaps",), ("C06 rate", "C07 gaps"))
    asked = Asked({"spike": {"tracecheck": loud, "baglint": quiet},
                   "in-rows": dict.fromkeys(DATASET_REFEREES, Opinion(True, (), ("idle #",)))}, ())
    recordings, datasets = "\n".join(told(both, asked)).split("\n\n")[:2]
    assert recordings.splitlines()[0].split()[3:5] == ["tracecheck", "baglint"]
    assert recordings.splitlines()[1].split()[1:5] == ["spikes", "C07,", "(C06)", "-"]
    assert datasets.splitlines()[0].split()[3:8] == list(DATASET_REFEREES)
    assert datasets.splitlines()[1].split()[2:7] == ["(idle)"] * 5
    assert (exit_code(both, asked), exit_code(both, replace(asked, alarms=("rdq on clean: too short",)))) == (0, 1)


def test_what_a_referee_says_of_good_data_is_let_pass_by_name_alone():
    known = Opinion(True, (), ("DATA-108 # dimension(s) never change across the whole dataset: target_z",))
    assert unexpected("robovet", known) == []
    other = Opinion(True, (), (*known.remarks, "STATS-304 quantiles"))
    assert unexpected("robovet", other) == ["STATS-304 quantiles"]
    assert unexpected("robovet", Opinion(False, ())) == ["failed without a reason"]
    assert news(other, [known]).remarks == ("STATS-304 quantiles",)


def test_files_are_never_kept_among_others(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match=r"not empty(?s:.*)mend: name a new one: --keep FOLDER"):
        run_selftest(keep=tmp_path)


def test_the_docs_name_every_fault():
    text = (ROOT / "docs/selftest.md").read_text()
    assert not [name for name in FAULTS if f"| {name} |" not in text]
