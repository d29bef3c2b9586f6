"""Forgetting an episode: no byte of it is found again, and everything else is as it was."""

import time
import warnings
from datetime import UTC, datetime

import numpy as np
import pytest

from pipeline.errors import DatasetError, StoreError
from pipeline.lerobot_view.manifest import load_version
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.store import Store
from pipeline.store.erasure_plan import plan_erasure
from pipeline.store.lineage import render, why
from stages.forget import forget

NOW = datetime(2026, 11, 24, tzinfo=UTC)


def gone(root, id, **how):
    with Store.open(root) as store:
        plan = plan_erasure(store, id, "asked by the person", NOW, **how)
        with store.lease(plan.id, erases=True) as lease:
            return forget(store, lease, plan)


@pytest.fixture
def lived(live, root):
    return live(root)


def test_a_canary_is_found_in_every_form_before_and_nowhere_afterwards(lived, root):
    before = lived.canary.found(root)
    forms = set.union(*before.values())
    assert forms >= {"bytes", "base64", "text", "float32", "jpeg", "video"}
    kinds = {name.split("/")[0] for name in before}
    assert {"blobs", "versions", "reports", "browse", "recordings", "tmp", "videos"} <= kinds
    assert any(name.startswith("catalog.db") for name in before)
    with Store.open(root) as store:
        attempt = store.hard_cases()[0].episode
    gone(root, lived.demo)
    gone(root, attempt)
    assert lived.canary.found(root) == {}
    assert not (root / "caches").exists()


def test_what_holds_the_episode_goes_and_nothing_else(lived, root):
    with Store.open(root) as store:
        before = {e.id for e in store.episodes()}
        plan = plan_erasure(store, lived.demo[:8], "x", NOW)
    done = gone(root, lived.demo)
    assert done.erasure.episodes == plan.episodes and len(plan.episodes) == 4, "two variants, and one that begins there"
    with Store.open(root) as store:
        assert {e.id for e in store.episodes()} == before - set(plan.episodes)
        assert store.verify() == []
        assert {v.id for v in done.versions} == {lived.version, lived.later}
        for version in done.versions:
            assert store.version(version.id) == version == load_version(store.path(version.path))
            assert set(version.erased) <= set(plan.episodes) and not set(version.episodes) & set(plan.episodes)
        shard = store.blob(store.episode(lived.spared[0]).blob)
    from pipeline.shards import read_shard
    assert set(read_shard(shard)) == set(lived.spared)


def test_what_stays_keeps_its_bits(live, tmp_path):
    one, two = live(tmp_path / "one"), live(tmp_path / "two")
    done = gone(two.root, two.demo)
    for version in done.versions:
        with Store.open(one.root) as store:
            old = store.version(version.id)
        before, after = one.table(version.id), two.table(version.id)
        rows = np.repeat([e in version.episodes for e in old.episodes], 10)
        for name in ("observation.state", "action", "intervention", "timestamp"):
            assert before.column(name).filter(rows).to_pylist() == after.column(name).to_pylist(), name
        assert after.column("index").to_pylist() == list(range(version.frames))


def test_lerobot_opens_what_is_left_without_a_warning(lived, root):
    gone(root, lived.demo)
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        data = LeRobotDataset("store/left", root=root / "versions" / lived.later, video_backend="pyav")
        assert len(data) == 40 and data[39]["episode_index"] == 3
        assert data[10]["observation.images.front"].shape == (3, 64, 64)


def test_an_incomplete_version_teaches_nothing_and_says_what_to_do(lived, root):
    gone(root, lived.demo)
    with pytest.raises(DatasetError, match=r"is incomplete: erased \(4 episodes\)(.|\n)*mend: .*hardcase build"):
        TrainingData.load(root / "versions" / lived.version)


def test_the_next_version_grows_from_an_incomplete_one(lived, root, small):
    from schemas.recipe import DatasetConfig, Recipe
    from stages.build import build
    gone(root, lived.demo)
    with Store.open(root) as store:
        demos = store.episodes(origin="scripted")
        parent = store.version(lived.version)
        recipe = Recipe(name="smoke", dataset=DatasetConfig(held_out=0.0, weights={"base": 0.5, "corrections": 0.5}))
        from pipeline.recording import read_frames
        version = build(demos, lambda e: read_frames(store.blob(e.blob))[1], recipe, store=root, task="pick",
                        generation=2, parent=parent)
    assert lived.demo not in version.episodes and version.erased == ()
    assert len(TrainingData.load(root / version.path).starts) == 3


def test_the_policy_that_saw_it_is_flagged_and_the_tombstone_tells(lived, root):
    done = gone(root, lived.demo)
    assert done.erasure.policies == (lived.policy,)
    with Store.open(root) as store:
        assert "saw what was forgotten: erased 4 episodes (2026-11-24: asked by the person)" in render(
            why(store, lived.policy))
        assert "incomplete: erased 4 episodes" in render(why(store, lived.version))
        told = render(why(store, lived.demo[:8]))
        assert "forgotten: on 2026-11-24: asked by the person" in told
        assert f"policies that saw it: {lived.policy}" in told
        assert f"policy {lived.policy}" in told.partition("used by:")[2]


def test_nothing_forgotten_comes_back(lived, root, small):
    with Store.open(root) as store:
        demo = store.episode(lived.demo)
        data = store.blob(demo.blob).read_bytes()
    gone(root, lived.demo)
    with Store.open(root) as store, store.lease(small.run) as lease:
        with pytest.raises(StoreError, match=r"was forgotten on 2026-11-24: asked by(.|\n)*mend: leave it out"):
            store.put_blob(data)
        (store.tmp / "again.mcap").write_bytes(data)
        with pytest.raises(StoreError, match="was forgotten"):
            store.put_blob(store.tmp / "again.mcap", move=True)
        with pytest.raises(StoreError, match=r"episode .* was forgotten"), store.commit(lease) as tx:
            tx.add_episodes([demo.model_copy(update={"blob": None})])
        with pytest.raises(StoreError, match="was forgotten on 2026-11-24"):
            store.episode(lived.demo)
    assert lived.canary.in_bytes(b"".join(p.read_bytes() for p in (root / "tmp").rglob("*") if p.is_file())) == set()


def test_a_correction_goes_with_its_attempt_but_not_the_other_way(lived, root):
    with Store.open(root) as store:
        (case,) = store.hard_cases()
    gone(root, case.correction)
    with Store.open(root) as store:
        (left,) = store.hard_cases()
        assert (left.correction, left.corrected) == (None, False)
        assert store.episode(case.episode).id == case.episode
    gone(root, case.episode)
    with Store.open(root) as store:
        assert store.hard_cases() == []
        assert "hard case" in render(why(store, case.id)) and "forgotten: on" in render(why(store, case.id))


def test_a_version_that_lost_everything_keeps_its_name_and_teaches_nothing(lived, root):
    with Store.open(root) as store:
        demos = [e.id for e in store.episodes(origin="scripted")]
    for demo in demos:
        gone(root, demo)
    with Store.open(root) as store:
        version = store.version(lived.version)
        assert (version.episodes, version.frames, len(version.erased)) == ((), 0, 11)
        assert store.policy(lived.policy).dataset == version.id
    with pytest.raises(DatasetError, match="is incomplete: erased"):
        TrainingData.load(root / version.path)


def test_a_loop_that_runs_is_left_alone(lived, root, small):
    with Store.open(root) as store, store.lease(small.run, holder="hardcase loop"):
        with pytest.raises(StoreError, match=r"another loop uses this store: .*hardcase loop(.|\n)*mend: wait for it"):
            gone(root, lived.demo)
        assert store.episode(lived.demo)


@pytest.mark.parametrize("name, message", [
    ("policy", r"is no episode but a policy(.|\n)*mend: name one of its episodes"),
    ("case", r"is no episode but a hard case(.|\n)*mend: name its episode: hardcase forget [0-9a-f]{16}"),
    ("twice", r"was forgotten already(.|\n)*mend: see what went with it: hardcase why"),
    ("nothing", r"is not in the store(.|\n)*mend: "), ("words", "not a valid id"),
])
def test_what_cannot_be_forgotten_is_said_in_one_error(lived, root, name, message):
    with Store.open(root) as store:
        case = store.hard_cases()[0].id
    if name == "twice":
        gone(root, lived.demo)
    asked = {"policy": lived.policy, "case": case, "twice": lived.demo, "nothing": "0" * 16, "words": "../../x"}[name]
    with pytest.raises(StoreError, match=message):
        gone(root, asked)


def test_what_somebody_writes_now_is_not_deleted_under_them(lived, root, children):
    def write():
        with (root / "tmp/growing").open("wb"):
            (root / "tmp/ready").touch()
            time.sleep(60)

    child = children(write)
    while not (root / "tmp/ready").exists():
        time.sleep(0.01)
    with pytest.raises(StoreError, match=rf"being written in the store: pid {child} (.|\n)*mend: wait for it"):
        gone(root, lived.demo)
    with Store.open(root) as store:
        assert store.episode(lived.demo) and not store.unfinished_erasures()
