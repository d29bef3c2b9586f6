"""Versions of robots that are not the reference arm: their own features, one set a version."""

import json

import numpy as np
import pytest

from pipeline.errors import DatasetError, RecordingError
from pipeline.frames import FEATURES, FeatureTable
from pipeline.lerobot_view.training_data import TrainingData
from schemas.recipe import DatasetConfig, Recipe
from stages.build import build

G1 = {"observation.state": ("hip", "knee", "ankle"), "action": tuple(f"motor{k}" for k in range(12)),
      "skew.action": ("/cmd",)}
RECIPE = Recipe(name="g1", dataset=DatasetConfig(only_success=False, weights={"base": 1.0}))


def table(episode, names=G1):
    rng = np.random.default_rng(int(episode.id, 16))
    return FeatureTable(names, {n: rng.standard_normal((episode.frames, len(v))).astype(np.float32)
                                for n, v in names.items()})


@pytest.fixture
def g1(episode):
    def make(name):
        made = episode(name)
        return made.model_copy(update={"scene": made.scene.model_copy(update={"robot": "g1"})})
    return make


def test_a_version_has_the_declared_features_with_exact_statistics(g1, tmp_path):
    episodes = [g1(n) for n in "abcd"]
    version = build(episodes, table, RECIPE, store=tmp_path, task="walk", generation=0, features=G1)
    folder = tmp_path / version.path
    info = json.loads((folder / "meta/info.json").read_text())
    assert info["features"]["action"] == {"dtype": "float32", "shape": [12], "names": list(G1["action"])}
    assert info["features"]["skew.action"] == {"dtype": "float32", "shape": [1], "names": ["/cmd"]}
    everything = np.concatenate([table(e).values["action"] for e in episodes])
    stats = json.loads((folder / "meta/stats.json").read_text())["action"]
    assert stats["mean"] == pytest.approx(everything.mean(axis=0, dtype=np.float64))
    assert stats["q99"] == pytest.approx(np.quantile(everything.astype(np.float64), 0.99, axis=0))


def test_a_later_version_shares_the_files_of_its_parent(g1, tmp_path):
    episodes = [g1(n) for n in "abcd"]
    parent = build(episodes[:3], table, RECIPE, store=tmp_path, task="walk", generation=0, features=G1)
    child = build(episodes, table, RECIPE, store=tmp_path, task="walk", generation=1, parent=parent, features=G1)
    file = "data/chunk-000/file-000.parquet"
    assert (tmp_path / parent.path / file).samefile(tmp_path / child.path / file)
    assert child.frames == 4 * 12


@pytest.mark.parametrize(("change", "line"), [
    ({"action": G1["action"][:11]}, "action has 11 values, robot 'g1' expects 12"),
    ({"observation.state": ("hip", "ankle", "knee")}, r"observation.state\[1\] is 'ankle', robot 'g1' expects 'knee'"),
    ({"skew.action": None}, "skew.action, which robot 'g1' has, is missing"),
    ({"velocity": ("hip",)}, "velocity is a feature that robot 'g1' does not have"),
], ids=["width", "order", "missing", "more"])
def test_an_episode_with_other_features_is_named_in_one_line(g1, tmp_path, change, line):
    other = {n: v for n, v in (G1 | change).items() if v}
    episodes = [g1("a"), g1("b")]
    with pytest.raises(DatasetError, match=line) as error:
        build(episodes, lambda e: table(e, other if e is episodes[1] else G1), RECIPE, store=tmp_path, task="walk",
              generation=0, features=G1)
    assert episodes[1].id in error.value.where
    assert "ingest these logs again" in error.value.mend
    assert not list((tmp_path / "versions").iterdir())


def test_a_parent_of_another_robot_is_refused(g1, tmp_path):
    parent = build([g1("a")], table, RECIPE, store=tmp_path, task="walk", generation=0, features=G1)
    fewer = G1 | {"action": G1["action"][:5]}
    with pytest.raises(DatasetError, match="action has 12 values, robot 'g1' expects 5"):
        build([g1("a"), g1("b")], lambda e: table(e, fewer), RECIPE, store=tmp_path, task="walk", generation=1,
              parent=parent, features=fewer)


def test_a_value_that_is_not_finite_is_refused(g1, tmp_path):
    bad = table(g1("a"))
    bad.values["action"][3, 7] = np.nan
    with pytest.raises(RecordingError, match=r"action\[7\] is nan at frame 3"):
        build([g1("a")], lambda _: bad, RECIPE, store=tmp_path, task="walk", generation=0, features=G1)


def test_the_arms_policies_do_not_train_on_another_robot(g1, tmp_path):
    version = build([g1("a"), g1("b")], table, RECIPE, store=tmp_path, task="walk", generation=0, features=G1)
    with pytest.raises(DatasetError, match=r"observation.state has 3 values, robot 'arm' expects 16"):
        TrainingData.load(tmp_path / version.path)


def test_each_episode_may_have_its_own_task(g1, tmp_path, frames):
    episodes = [g1("a"), g1("b")]
    version = build(episodes, table, RECIPE, store=tmp_path, task={episodes[0].id: "walk", episodes[1].id: "turn"},
                    generation=0, features=G1)
    manifest = json.loads((tmp_path / version.path / "meta/hardcase.json").read_text())
    assert manifest["task"] == ["turn", "walk"]


def test_features_and_notes_tell_versions_apart(g1, tmp_path):
    def made(**how):
        return build([g1("a")], lambda e: table(e, how.get("features", G1)), RECIPE, store=tmp_path, task="walk",
                     generation=0, **{"features": G1, **how}).id

    renamed = G1 | {"skew.action": ("cmd",)}
    assert len({made(), made(), made(features=renamed), made(notes={"cameras": ["head"]})}) == 3


def test_the_arms_frames_are_a_table_like_any_other(episode, frames):
    taken = frames(episode("a"))
    assert taken.names is FEATURES
    assert list(taken.columns()) == list(FEATURES)
