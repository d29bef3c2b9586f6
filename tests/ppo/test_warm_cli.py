"""`hardcase rl clone`, `rl train --warm` and the study of both as people type them."""

import json

import pytest

from flows.studies import finetuning, warmstart
from flows.studies.warmstart import steps_to
from pipeline.files import sha256_file
from pipeline.locomotion import demonstrations


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    monkeypatch.setattr(demonstrations, "SIDE_BY_SIDE", 8)
    return tmp_path / "store"


def test_a_training_goes_on_from_a_clone_and_from_a_training(hardcase, store, tmp_path):
    code, said, _ = hardcase("rl", "clone", "balance", "--calm", "--attempts", 3, "--json")
    told, folder = json.loads(said), store / "rl" / "clone-balance-biped-stand-0"
    assert (code, told["demonstrations"]["kept"]) == (0, 3)
    assert told["weights"] == sha256_file(folder / "weights.safetensors")
    assert hardcase("rl", "evaluate", folder, "--attempts", 4)[0] == 0
    few = ("--steps", 600, "--attempts", 8)
    code, said, _ = hardcase("rl", "train", "--warm", folder, *few, "--out", tmp_path / "one", "--json")
    assert (code, json.loads(said)["order"]["goes_on"]) == (0, told["weights"])
    assert hardcase("rl", "train", "--warm", folder, *few, "--out", tmp_path / "one", "--resume")[0] == 0
    code, said, _ = hardcase("rl", "train", "--warm", tmp_path / "one", *few, "--out", tmp_path / "two", "--json")
    assert code == 0
    assert json.loads(said)["order"]["goes_on"] == sha256_file(tmp_path / "one" / "weights.safetensors")
    code, _, told = hardcase("rl", "clone", "balance")
    assert (code, "mend: give another folder with --out" in told) == (2, True)
    code, _, told = hardcase("rl", "clone", tmp_path / "two", "--attempts", 1, "--out", tmp_path / "three")
    assert (code, "the expert fell in all of" in told) == (2, True)


@pytest.mark.parametrize(("words", "mend"), [
    (("train", "--warm", "nowhere"), "name a folder that hardcase rl clone or hardcase rl train has left"),
    (("train", "--warm", "."), "name a folder that hardcase rl clone or hardcase rl train has left"),
    (("clone", "nobody"), "export the policy again"),
    (("clone", "balance", "--body", "bipet"), "use one of"),
    (("clone", "balance", "--stratum", "flying"), "use one of: leaning"),
], ids=["no weights", "no folder of ours", "no expert", "body", "stratum"])
def test_bad_input_is_told_in_one_line_with_its_mend(hardcase, store, tmp_path, monkeypatch, words, mend):
    monkeypatch.chdir(tmp_path)
    code, _, told = hardcase("rl", *words)
    assert (code, "Traceback" in told) == (2, False)
    assert mend in " ".join(told.split())


def test_damaged_weights_are_refused(hardcase, store, tmp_path):
    (tmp_path / "weights.safetensors").write_bytes(b"\x80\x04 not weights")
    code, _, told = hardcase("rl", "train", "--warm", tmp_path, "--steps", 600, "--attempts", 8)
    assert (code, "these weights cannot be gone on from" in told, "Traceback" in told) == (2, True, False)


def test_steps_to_a_share_are_counted_over_many_iterations():
    curve = [{"step": 100 * (k + 1), "full": 2 * (k >= 30), "fallen": 2 * (k < 30)} for k in range(60)]
    assert steps_to(curve, 0.5) == 4000  # ten of the last twenty iterations
    assert steps_to(curve, 0.9, before=7) == 4807
    assert steps_to(curve[:40], 0.9) is None
    assert steps_to(curve[:10], 0.5) is None


def test_the_study_tells_all_arms(hardcase, store, tmp_path, monkeypatch):
    for module in (warmstart, finetuning):
        monkeypatch.setattr(module, "ATTEMPTS", 4)
    monkeypatch.setattr(finetuning, "SOUGHT", 8)
    monkeypatch.setattr(warmstart, "DEMONSTRATED", 2)
    monkeypatch.setattr(warmstart, "EXPERTS", ("balance",))  # a teacher of so few steps always falls
    monkeypatch.setattr(warmstart, "ARMS", ("scratch", "balance"))
    code, said, _ = hardcase("measure", "warmstart", "--seeds", 2, "--steps", 4000, "--further", 4000, "--json",
                             tmp_path / "w.json")
    assert (code, "further steps" in said) == (0, True)
    found = json.loads((tmp_path / "w.json").read_text())
    assert [row["seed"] for row in found["rows"]] == [100, 101]
    assert set(found["rates"]["thrown"]) == {"scratch", "balance", "clone of balance"}
    assert found["rows"][0]["arms"]["balance"]["demonstrated"] > 0
    hard = found["finetuning"]["rates"]["hard"]
    assert set(hard["apart"]) == {"hard - ordinary", "hard - before", "ordinary - before"}
    assert hard["starts"] == [row["fresh"] for row in found["finetuning"]["rows"]]
