"""The real loop as a person runs it, read back: one finished smoke loop with its control is shared by all tests."""

import json
import logging
import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flows.service.estimate import plan
from pipeline.frames import FEATURES
from pipeline.recipes import load_recipe
from pipeline.recording import read_frames
from pipeline.shards import read_shard
from pipeline.store import Store
from schemas.episode import VARIANTS
from schemas.summary import LoopResult

pytestmark = pytest.mark.xdist_group("lerobot")

LINE = re.compile(r"(control )?generation \d/1  \w+ +(\d+\.\d s|kept)  .+$")
LAP = ("augment", "build", "train", "gate", "release", "exam", "deploy", "harvest")


@pytest.fixture(scope="module")
def store(turned) -> Iterator[Store]:
    with Store.open(turned.store) as opened:
        yield opened


def test_the_json_has_the_promised_shape(turned):
    told = json.loads((turned.folder / "result.json").read_text())
    assert set(told) == {"generations", "control", "paired", "wall_s", "peak_pss_mb", "seed", "twin", "shadow", "worth"}
    assert set(told["paired"]) == {"fixed", "broken", "p"}
    for lap in (*told["generations"], *told["control"]):
        assert set(lap) == {"generation", "dataset_version", "policy", "success", "gate", "robot_s", "corrections",
                            "wall_s"}
        assert set(lap["success"]) == {"all", "common", "rare", "deployment_mix"}
        assert all(set(p) == {"n", "successes", "rate", "low", "high"} for p in lap["success"].values())
        assert set(lap["gate"]) == {"verdict", "p"}
    assert [lap["generation"] for lap in told["generations"]] == [0, 1]
    assert set(told["generations"][0]["wall_s"]) == {"collect", *LAP}
    assert (told["seed"], told["twin"]) == (0, 100)
    assert told["wall_s"] > 1 and 100 < told["peak_pss_mb"] < 1500


def test_the_last_lap_is_appraised(turned):
    """Who was right in the shadow, and what the last batch was worth: on the screen, and as numbers."""
    told = json.loads((turned.folder / "result.json").read_text())
    shadow, worth = told["shadow"], told["worth"]
    assert 0 < sum(shadow["right"].values()) == shadow["judged"] <= shadow["apart"] <= shadow["attempts"]
    low, high = shadow["change"][1:]
    assert low <= shadow["change"][0] <= high
    assert f"Shadow: candidate and champion apart in {shadow['apart']} of {shadow['attempts']}" in turned.done.stdout
    assert worth["generation"] == 1 and worth["seeds"] == 1 and -100 <= worth["points"] <= 100
    assert f"Worth of the last batch: {worth['points']:+.1f} points" in turned.done.stdout
    assert "1 seed, indicative" in turned.done.stdout


def test_nothing_but_one_line_a_stage_reaches_stderr(turned):
    lines = turned.done.stderr.splitlines()
    assert len(lines) == len(plan(load_recipe("smoke"), control=True))
    assert [line for line in lines if not LINE.match(line)] == []


def test_stdout_is_the_table_and_the_path_of_a_report_that_is_there(turned, run):
    out = turned.done.stdout
    assert not re.search(r"Traceback|WARNING|Warning", out)
    page = Path(re.search(r"^Report: (.+)$", out, re.MULTILINE)[1])
    assert page == turned.store / "reports" / f"{run}.html"
    text = page.read_text()
    assert "<html" in text and turned.result().generations[-1].policy in text


def test_the_control_shares_generation_0_and_learns_from_as_many_new_episodes(turned):
    told = turned.result()
    first, control = told.generations[0], told.control[0]
    assert control.model_copy(update={"wall_s": first.wall_s}) == first
    assert told.control[1].dataset_version != told.generations[1].dataset_version
    assert told.control[1].corrections == told.generations[1].corrections > 0


def test_loop_and_control_get_the_same_variants_for_every_new_episode(store):
    share = load_recipe("smoke").augment.per_correction
    for run in store.runs():
        first = {e.id for e in store.episodes(store.step(run, 0, "collect").outputs["ids"])}
        new = [e.id for e in store.episodes(store.step(run, 0, "harvest").outputs["ids"])
               if e.outcome.label == "success"]
        told = store.step(run, 1, "augment").outputs["report"]
        assert told["tried"] == {"retarget": share * len(new)}
        assert sum(told["kept"].values()) == len(store.step(run, 1, "augment").outputs["ids"])
        assert len(new) > 0
        for id in store.step(run, 1, "augment").outputs["ids"]:
            (variant,) = store.episodes([id])
            assert variant.parent in first and str(variant.transform).split()[-1] in new


def test_every_lap_grew_from_what_the_one_before_it_harvested(turned, store, run):
    zero, one = store.versions(run=run)
    corrected = {e.id for e in store.episodes(store.step(run, 0, "harvest").outputs["ids"])
                 if e.outcome.label == "success"}
    assert corrected and corrected <= set(one.episodes)
    assert one.episodes[:len(zero.episodes)] == zero.episodes
    assert [lap.dataset_version for lap in turned.result().generations] == [zero.id, one.id]


def test_the_exam_has_the_same_scenes_in_every_generation(store):
    strata = [result["strata"] for id in store.runs() for step in store.steps(id) if step.stage == "exam"
              for result in step.outputs["results"].values()]
    assert len(strata) >= 4
    assert all(found == strata[0] for found in strata)


def test_tables_of_a_version_equal_what_was_recorded(store, run):
    version = store.versions(run=run)[-1]
    table = pa.concat_tables(pq.read_table(f) for f in sorted(store.path(version.path).glob("data/*/*.parquet")))
    episodes = store.episodes(version.episodes)
    assert {"scripted", "corrected"} < {e.origin for e in episodes}
    index = table["episode_index"].to_numpy()
    for number, episode in enumerate(episodes):
        blob = store.blob(episode.blob)
        frames = read_shard(blob)[episode.id] if episode.origin in VARIANTS else read_frames(blob)[1]
        rows = table.filter(index == number)
        for name, recorded in frames.columns().items():
            assert np.array_equal(np.stack(rows[name].to_numpy(zero_copy_only=False)), recorded), (episode.id, name)
    assert len(table) == version.frames


def test_lerobot_opens_every_version_without_a_warning(store, tmp_path, monkeypatch):
    for name in ("HF_HOME", "HF_DATASETS_CACHE", "HF_LEROBOT_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    class Loud(logging.Handler):
        def emit(self, record):
            raise AssertionError(f"{record.name} logged: {record.getMessage()}")

    loud = Loud(logging.WARNING)
    logging.getLogger().addHandler(loud)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for version in store.versions():
                data = LeRobotDataset("hardcase/version", root=store.path(version.path), video_backend="pyav")
                assert len(data) == version.frames
                assert set(FEATURES) <= set(data[len(data) - 1])
    finally:
        logging.getLogger().removeHandler(loud)


def test_why_walks_from_a_policy_back_to_recordings_draws_seeds_and_code(turned, store, run):
    policy = store.policies(run=run)[-1]
    told = turned.run("why", policy.id[:8])
    assert told.returncode == 0, told.stderr
    episodes = store.episodes(store.version(policy.dataset).episodes)
    correction = next(e for e in episodes if e.origin == "corrected")
    for words in (policy.id, policy.dataset, policy.code[:12], "seed", "draws", "friction", "collect", "recordings",
                  correction.blob[:12]):
        assert words in told.stdout, f"{words} is not in\n{told.stdout}"
    whole = json.loads(turned.run("why", policy.id, "--json").stdout)
    text = json.dumps(whole)
    assert all(e.id in text and e.blob in text and str(e.scene.seed) in text for e in episodes)


def test_the_same_order_again_redoes_nothing(turned):
    before = turned.manifests()
    again = turned.run("loop", "--recipe", "smoke", "--control", "--json", str(turned.folder / "again.json"))
    assert again.returncode == 0, again.stderr
    assert turned.manifests() == before
    assert all(" kept " in line for line in again.stderr.splitlines()[:-1])
    told = LoopResult.model_validate_json((turned.folder / "again.json").read_text())
    assert (told.generations, told.control, told.paired) == (
        turned.result().generations, turned.result().control, turned.result().paired)
