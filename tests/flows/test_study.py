"""The study: every arm of every seed, pooled, and the last batch judged in full."""

import json

import pytest

from flows.studies.study import run_study
from pipeline.errors import ConfigError
from schemas.worth import LEAST_SEEDS

pytestmark = pytest.mark.xdist_group("lerobot")

TINY = """
name: tiny-study
generations: 1
collect: {demonstrations: 4}
augment: {replays: 0, retargets: 0, per_correction: 2}
train: {chunk: 8, steps: 30, batch: 32, checkpoint_every: 30}
gate: {looks: [12], bootstrap_success: 0.0}
deploy: {episodes: 12, rare_share: 0.25, shadow: false}
harvest: {corrections: 4}
exam: {common: 4, rare: 2}
"""


@pytest.fixture(scope="module")
def studied(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    (folder / "tiny.yaml").write_text(TINY)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HARDCASE_STORE", str(folder / "store"))
        yield folder, run_study(seeds=1, recipe=str(folder / "tiny.yaml"), json=folder / "out.json",
                                arms=("random",), worth_scenes=20)


def test_a_study_pools_its_arms_and_judges_the_last_batch_in_full(studied, capsys):
    folder, found = studied
    assert json.loads((folder / "out.json").read_text()) == found
    (seed,) = found["seeds"]
    assert set(seed["arms"]) == {"", "random"}
    assert [lap["generation"] for lap in seed["arms"][""]["laps"]] == [0, 1]
    (worth,) = found["worths"]
    verdict = worth["worth"]
    assert worth["lap"] == 1 and verdict["episodes"]
    assert len(verdict["seeds_with"]) == len(verdict["seeds_without"]) == LEAST_SEEDS
    assert verdict["decision"] in ("HELPS", "HURTS", "INCONCLUSIVE") and verdict["reason"]


def test_a_finished_study_is_not_run_again_and_other_arms_are_refused(studied, monkeypatch):
    folder, found = studied
    monkeypatch.setenv("HARDCASE_STORE", str(folder / "store"))
    before = {p: p.stat().st_mtime_ns for p in (folder / "store").rglob("*.json")}
    again = run_study(seeds=1, recipe=str(folder / "tiny.yaml"), json=None, arms=("random",))
    assert again["worths"] == found["worths"] and again["pooled"] == found["pooled"]
    assert {p: p.stat().st_mtime_ns for p in (folder / "store").rglob("*.json")} == before
    with pytest.raises(ConfigError, match="name those with --arm, or remove the file"):
        run_study(seeds=1, recipe=str(folder / "tiny.yaml"), json=None, arms=("oracle",))
