"""`hardcase rl` and `hardcase measure stand` as people type them."""

import json

import pytest

TINY = ("--steps", 2000, "--attempts", 16)


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    return tmp_path / "store"


def test_a_training_is_evaluated_beside_both_baselines(hardcase, store):
    code, said, _ = hardcase("rl", "train", "--seed", 2, *TINY, "--json")
    trained = json.loads(said)
    assert (code, trained["order"]["seed"]) == (0, 2)
    assert trained["steps"] >= 2000
    assert trained["onnx_apart"] < 1e-5
    folder = store / "rl" / "biped-stand-2"
    assert {"policy.onnx", "training.json"} < {file.name for file in folder.iterdir()}
    assert list(json.loads((folder / "training.json").read_text())["curve"][0]["terms"]) == [
        "upright", "height", "still", "posture", "effort"]
    code, said, _ = hardcase("rl", "evaluate", folder, "--attempts", 20, "--json")
    found = json.loads(said)
    assert (code, list(found["arms"])) == (0, ["policy", "zero action", "random action"])
    for arm in found["arms"].values():
        assert 0 <= arm["low"] <= arm["rate"] <= arm["high"] <= 1
    code, said, _ = hardcase("rl", "train", "--seed", 2, *TINY, "--resume")
    assert (code, "next: hardcase rl evaluate" in said) == (0, True)
    code, _, told = hardcase("rl", "train", "--seed", 2, *TINY)
    assert (code, "mend: go on with --resume" in told) == (2, True)
    code, _, told = hardcase("rl", "train", "--seed", 2, "--steps", 4000, "--resume")
    assert (code, "checkpoint of another training" in told) == (2, True)


@pytest.mark.parametrize(("words", "mend"), [
    (("train", "--body", "bipet"), "use one of: PATH.urdf, PATH.xml, biped, unitree_g1, unitree_h1"),
    (("train", "--body", "robot.xml"), "give an MJCF or URDF file"),
    (("train", "--task", "run"), "use one of: PATH.yaml, balance, stand, walk"),
    (("train", "--task", "run.yaml"), "name a task"),
    (("train", "--stratum", "flying"), "use one of: leaning"),
    (("train", "--learning-rate", -1), "pipeline/ppo/config.py"),
    (("evaluate", "nowhere.onnx"), "export the policy again"),
    (("evaluate", "."), "finish the training"),
], ids=["body", "body's file", "task", "task's file", "stratum", "number", "no policy", "no training"])
def test_bad_input_is_told_in_one_line_with_its_mend(hardcase, store, tmp_path, monkeypatch, words, mend):
    monkeypatch.chdir(tmp_path)
    code, _, told = hardcase("rl", *words)
    assert code == 2
    assert "Traceback" not in told
    assert mend in " ".join(told.split())
