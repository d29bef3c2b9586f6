"""Walking as people ask for it: `measure walk`, `evaluate --speed`, and film strips."""

import json

import pytest
from PIL import Image

from pipeline.ppo.config import PpoConfig

TINY = PpoConfig(steps=512, attempts=16, ticks=8, batch=64, epochs=1, hidden=(8,))
WHO = ["policy", "zero action", "random action"]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Two seeds of a walking study that learns nothing: exit code, what was printed, its JSON, its store."""
    from flows.studies.walk import run_walk_study

    store = tmp_path_factory.mktemp("walk")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HARDCASE_STORE", str(store))
        patch.setattr("flows.rl.order.PPO_CONFIGS", {"walk": TINY})
        patch.setattr("flows.studies.legged.ATTEMPTS", 6)
        found = run_walk_study(seeds=2, body="biped", json=store / "walk.json")
    return found, store


def test_the_study_has_every_speed_and_both_baselines(study):
    found, store = study
    assert json.loads((store / "walk.json").read_text())["pooled"] == json.loads(json.dumps(found["pooled"]))
    speeds = ["0.5 m/s", "0 m/s", "0.2 m/s", "0.4 m/s", "0.6 m/s", "0.8 m/s"]
    assert [row["seed"] for row in found["rows"]] == [100, 101]
    for row in found["rows"]:
        assert list(row["arms"]) == speeds
        assert row["cpu_s"] > 0
        assert list(row["curve"][0]["terms"]) == list(row["order"]["task"]["weights"])
        for arms in row["arms"].values():
            assert list(arms) == WHO
            for arm in arms.values():
                assert arm["follows"]["rate"] <= arm["rate"]  # to walk is more than not to fall
    for kind in ("full", "walks"):
        for overall in found["pooled"][kind].values():
            assert list(overall["rate"]) == WHO
            assert all(r["low"] <= r["estimate"] <= r["high"] for r in overall["rate"].values())
    assert list(found["speeds"]) == speeds


def test_evaluate_asks_for_one_speed(study, hardcase):
    folder = study[1] / "rl" / "study" / "biped-walk-100"
    code, said, _ = hardcase("rl", "evaluate", folder, "--attempts", 4, "--speed", 0.5, "--json")
    found = json.loads(said)
    assert (code, found["speed"]) == (0, 0.5)
    assert found["arms"]["zero action"]["error"] > 0.3  # it does not walk
    code, said, _ = hardcase("rl", "evaluate", folder, "--attempts", 4, "--speed", 0.5)
    assert (code, "0.5 m/s asked" in said) == (0, True)


def test_a_strip_shows_the_attempt_until_its_fall(study, hardcase, tmp_path):
    folder = study[1] / "rl" / "study" / "biped-walk-100"
    code, said, _ = hardcase("rl", "evaluate", folder, "--attempts", 1, "--speed", 0.5, "--strip",
                             tmp_path / "walk.webp")
    said = said.splitlines()[-1]
    assert (code, "where it fell" in said) == (0, True)
    with Image.open(tmp_path / "walk.webp") as picture:
        assert picture.format == "WEBP"
        assert picture.height == 210
        assert picture.width == 180 * int(said.split()[0])
        assert len(set(picture.convert("L").get_flattened_data())) > 30  # not one colour


def test_a_strip_of_another_task_begins_at_the_start(hardcase, straight, tmp_path):
    straight.export(tmp_path / "policy.onnx")
    code, said, told = hardcase("rl", "evaluate", tmp_path / "policy.onnx", "--attempts", 1, "--json", "--strip",
                                tmp_path / "stand.png")
    assert (code, " from 0.00 s to " in told, json.loads(said)["attempts"]) == (0, True, 1)
    with Image.open(tmp_path / "stand.png") as picture:
        assert picture.width % 180 == 0


@pytest.mark.parametrize(("words", "mend"), [
    (("--speed", 3), "ask for 0 to 0.8 m/s"),
    (("--attempts", 1, "--strip", "walk.gif"), "give a name that ends in .webp or .png"),
], ids=["speed", "kind of picture"])
def test_what_cannot_be_done_is_told_in_one_line_with_its_mend(study, hardcase, words, mend):
    code, _, told = hardcase("rl", "evaluate", study[1] / "rl" / "study" / "biped-walk-100", *words)
    assert code == 2
    assert "Traceback" not in told
    assert mend in " ".join(told.split())


def test_a_policy_that_was_never_asked_for_a_speed_is_not_asked(hardcase, straight, tmp_path):
    straight.export(tmp_path / "policy.onnx")
    code, _, told = hardcase("rl", "evaluate", tmp_path / "policy.onnx", "--speed", 0.5)
    assert (code, "train one that walks: hardcase rl train --task walk" in " ".join(told.split())) == (2, True)
