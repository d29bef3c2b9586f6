"""hardcase check as a person uses it: exit codes, table, JSON, ids, the store, and what is kept out of training."""

import json

import pytest
from typer.testing import CliRunner

from flows.cli import app
from pipeline.check.door import Verdicts
from pipeline.errors import DatasetError, HardcaseError
from pipeline.recording import read_frames
from pipeline.store import Store
from schemas.episode import Episode
from stages.build import build


@pytest.fixture
def hardcase(monkeypatch, tmp_path):
    """The command line on a store of its own, which is not there until something makes it."""
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    runner = CliRunner()

    def run(*arguments):
        done = runner.invoke(app, [str(a) for a in arguments])
        if isinstance(done.exception, HardcaseError):
            raise done.exception
        return done

    return run


def late_action(t):
    t.joint_action[8:] = t.joint_action[:-8].copy()


def test_a_good_recording_passes_with_exit_code_0(hardcase, demos):
    done = hardcase("check", demos[0])
    assert done.exit_code == 0
    assert done.output.startswith(f"{demos[0].name}: passed, 20 checks (9 had nothing to look at)")


def test_a_bad_one_fails_with_exit_code_1_one_line_a_finding_and_the_mend(hardcase, demos, spoil_trace):
    done = hardcase("check", demos[1], spoil_trace(late_action))
    assert done.exit_code == 1
    lines = done.output.splitlines()
    assert lines[1].endswith(": FAILED, 21 checks (8 had nothing to look at)")
    assert lines[2].split()[:3] == ["error", "lag", "/joint_commands.position"]
    assert "/joint_states.position runs ahead of /joint_commands.position by 0.39" in lines[2]
    assert "1 of 2 passed" in lines
    assert lines[-1].startswith("mend lag: pair each action with the state that it was sent for")


def test_what_cannot_be_read_gives_exit_code_2_and_the_others_are_checked(hardcase, demos, tmp_path):
    (tmp_path / "text.mcap").write_text("hello")
    done = hardcase("check", tmp_path / "text.mcap", tmp_path / "none.mcap", demos[0])
    assert done.exit_code == 2
    assert "text.mcap: cannot be read: not an MCAP file (bad magic at byte 0)" in done.output
    assert "none.mcap: cannot be read: no such file or folder" in done.output
    assert f"{demos[0].name}: passed" in done.output


def test_json_holds_every_finding_with_its_numbers(hardcase, spoil_trace, tmp_path):
    hardcase("check", spoil_trace(late_action), "--json", tmp_path / "out.json")
    content = json.loads((tmp_path / "out.json").read_text())
    finding = content["items"][0]["findings"][0]
    assert content["passed"] is False and content["items"][0]["passed"] is False
    assert finding["check"] == "lag" and finding["value"] < 0 and finding["limit"] == 0 and finding["mend"]


def test_the_same_episode_twice_is_told_of_the_second(hardcase, demos, tmp_path):
    copy = tmp_path / "again.mcap"
    copy.write_bytes(demos[0].read_bytes())
    done = hardcase("check", demos[0], demos[1], copy)
    assert done.exit_code == 1
    assert f"holds the same motion as {demos[0].name}" in done.output
    assert f"{demos[0].name}: passed" in done.output and "again.mcap: FAILED" in done.output


def test_a_contract_is_printed_from_good_logs_and_refused_from_bad_ones(hardcase, demos, spoil_trace, tmp_path):
    done = hardcase("check", demos[0], demos[1], demos[2], "--init")
    (tmp_path / "contract.yaml").write_text(done.output)
    assert hardcase("check", demos[3], "--contract", tmp_path / "contract.yaml").exit_code == 0
    with pytest.raises(HardcaseError, match="not a good log: lag") as refused:
        hardcase("check", spoil_trace(late_action), "--init")
    assert "hardcase check spoiled.mcap" in refused.value.mend


def test_a_version_and_its_episode_are_checked_by_id_and_what_fails_is_kept_out(hardcase, tmp_path):
    """The whole way: collect, check by id, build without what failed, and refuse to train on what failed later."""
    (tmp_path / "strict.yaml").write_text("evaluation: {control_hz: 50}\n")
    hardcase("collect", "--recipe", "smoke")
    with Store.open(tmp_path / "store") as store:
        first, second = (e.id for e in store.episodes(origin="scripted", label="success")[:2])
    assert hardcase("check", first, "--contract", tmp_path / "strict.yaml").exit_code == 1
    why = hardcase("why", first).output
    assert "check: FAILED: evaluation: the control rate [Hz] is 20.0, the evaluation has 50.0" in why
    assert first not in hardcase("augment", "--json").output
    made = json.loads(hardcase("build", "--json").output)
    assert made["says"].endswith("; 1 left out, they failed their check")
    version = made["ids"][0]
    with Store.open(tmp_path / "store") as store:
        held = store.episodes(store.version(version).episodes)
        assert first not in {e.id for e in held} | {e.parent for e in held}
    assert hardcase("check", version).exit_code == 0
    assert "check: passed" in hardcase("why", version).output
    hardcase("check", second, "--contract", tmp_path / "strict.yaml")
    with pytest.raises(DatasetError, match=f"episode {second} failed its check; it cannot be used for training"):
        hardcase("train")
    assert hardcase("check", second).exit_code == 0  # the last verdict counts: a false alarm is taken back
    hardcase("check", version, "--contract", tmp_path / "strict.yaml")
    with pytest.raises(DatasetError, match=f"version {version} failed its check") as refused:
        hardcase("train")
    assert f"hardcase check {version}" in refused.value.mend


def test_a_variant_is_refused_with_what_to_check_instead(hardcase):
    hardcase("collect", "--recipe", "smoke")
    variant = json.loads(hardcase("augment", "--json").output)["ids"][0]
    with pytest.raises(HardcaseError, match="is a variant and has no recording of its own") as refused:
        hardcase("check", variant)
    assert "check what it was made from" in refused.value.mend


def test_an_episode_that_failed_is_refused_where_it_is_asked_for(demos, recipe, tmp_path, findings, spoil_trace):
    episodes = [read_frames(path) for path in demos]
    bad = findings(spoil_trace(late_action)).model_copy(update={"subject": episodes[0][0].blob})
    verdicts = Verdicts({bad.subject: bad})
    frames = {e.id: f for e, f in episodes}

    def made(given: list[Episode]):
        return build(given, frames, recipe, store=tmp_path, task="pick", generation=0, verdicts=verdicts)

    everything = [e for e, _ in episodes]
    with pytest.raises(DatasetError, match=f"episode {everything[0].id} failed its check") as refused:
        made(everything)
    assert refused.value.where.startswith("lag: ") and f"hardcase check {everything[0].id}" in refused.value.mend
    assert [e.id for e in verdicts.passing(everything)] == [e.id for e in everything[1:]]
    assert set(made(verdicts.passing(everything)).episodes) == {e.id for e in everything[1:]}


def test_a_variant_falls_with_the_demonstration_that_it_was_made_from(demos, findings, spoil_trace):
    parent = read_frames(demos[0])[0]
    bad = findings(spoil_trace(late_action)).model_copy(update={"subject": parent.blob})
    variant = parent.model_copy(update={"id": "0" * 16, "origin": "replayed", "parent": parent.id, "blob": "1" * 64})
    correction = variant.model_copy(update={"id": "1" * 16, "origin": "corrected"})
    verdicts = Verdicts({bad.subject: bad})
    assert verdicts.passing([variant, correction], [parent]) == [correction]  # a correction has a file of its own
