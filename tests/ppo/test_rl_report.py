"""`hardcase rl report` of trainings that really ran."""

import json
import re

import pytest


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    from flows.rl.order import order_of
    from flows.rl.training import trained

    root = tmp_path_factory.mktemp("runs")
    for seed in range(2):
        trained(order_of("biped", "stand", seed, given={"steps": 600, "attempts": 8}), root / f"{seed}")
    return [root / f"{seed}" for seed in range(2)]


def test_what_is_not_evaluated_is_evaluated_once(folders, hardcase, tmp_path):
    words = ("rl", "report", *folders, "--attempts", 5, "--seed", 3, "--out", tmp_path / "page.html", "--json")
    code, said, _ = hardcase(*words)
    told = json.loads(said)
    assert (code, told["pooled"][0]["seeds"]) == (0, 2)
    kept = [(folder / "evaluations.json").read_bytes() for folder in folders]
    assert json.loads(hardcase(*words)[1]) == told
    assert [(folder / "evaluations.json").read_bytes() for folder in folders] == kept
    page = (tmp_path / "page.html").read_text()
    assert told["trainings"][0]["policy_sha256"][:16] in page
    assert len(re.findall(r'data-name="zero action"', page)) == 5
    _, said, _ = hardcase("rl", "evaluate", folders[0], "--attempts", 5, "--seed", 3, "--json")
    assert json.loads(said)["arms"]["zero action"] == told["trainings"][0]["evaluations"][0]["arms"]["zero action"]


@pytest.mark.parametrize("change", ["rate", "outcomes", "arms", "no json"])
def test_evaluations_that_do_not_fit_together_are_played_again(folders, hardcase, tmp_path, change):
    words = ("rl", "report", folders[0], "--attempts", 2, "--out", tmp_path / "page.html", "--json")
    right = json.loads(hardcase(*words)[1])["trainings"]
    file = folders[0] / "evaluations.json"
    kept = json.loads(file.read_text())
    one = next(e for e in kept if e["attempts"] == 2)
    if change == "rate":
        one["arms"]["policy"]["rate"] = 1.0
    elif change == "outcomes":
        one["outcomes"]["policy"] = "11"
    elif change == "arms":
        one["arms"] = {"<script>": one["arms"]["policy"]}
    file.write_text("{" if change == "no json" else json.dumps([one]))
    assert json.loads(hardcase(*words)[1])["trainings"] == right
    assert "<script>&" not in (tmp_path / "page.html").read_text()


def test_a_training_under_way_is_drawn_from_its_checkpoint(straight, hardcase, tmp_path):
    code, said, _ = hardcase("rl", "report", straight.folder, "--out", tmp_path / "page.html")
    assert (code, "384 steps; not evaluated" in said) == (0, True)
    assert "not written yet" in (tmp_path / "page.html").read_text()
