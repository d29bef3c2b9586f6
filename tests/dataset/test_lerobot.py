"""lerobot as the referee: it opens every version without a warning and reads what was recorded.

Importing lerobot takes 5 s, so that all tests that need it are in this file and share one process.
"""

import json
import logging
import warnings

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.frames import FEATURES
from pipeline.lerobot_view.samples import Samples
from pipeline.lerobot_view.training_data import TrainingData
from schemas.edits import Drop, Relabel, Reweight, Trim
from schemas.recipe import CameraConfig, DatasetConfig
from stages.build import build, load_version
from stages.derive import derive

pytestmark = pytest.mark.xdist_group("lerobot")


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """Opens a folder with LeRobotDataset; any warning, raised or logged, fails the test."""
    patch = pytest.MonkeyPatch()
    for name in ("HF_HOME", "HF_DATASETS_CACHE", "HF_LEROBOT_HOME"):
        patch.setenv(name, str(tmp_path_factory.mktemp(name)))
    patch.setenv("HF_HUB_OFFLINE", "1")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    class Loud(logging.Handler):
        def emit(self, record):
            raise AssertionError(f"{record.name} logged: {record.getMessage()}")

    def opened(folder, **how):
        loud = Loud(logging.WARNING)
        logging.getLogger().addHandler(loud)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                # named, because lerobot warns where torchcodec finds no FFmpeg; there is no video here to decode
                data = LeRobotDataset("hardcase/version", root=folder, video_backend="pyav", **how)
                data[0]
                return data
        finally:
            logging.getLogger().removeHandler(loud)

    yield opened
    patch.undo()


@pytest.fixture
def versions(episode, frames, recipe, task, tmp_path):
    """A base version and one that grew from it by corrections and a copy; with their episodes."""
    demos = [episode(f"demo {k}", length=9 + k) for k in range(8)]
    fixes = [episode(f"fix {k}", "corrected", parent=f"attempt {k}", generation=1, length=21, takeover=6)
             for k in range(3)]
    copy = episode("copy", "replayed", parent="demo 0", generation=1)
    base = build(demos, frames, recipe, store=tmp_path, task=task, generation=0)
    grown = build([*demos, *fixes, copy], frames, recipe, store=tmp_path, task=task, generation=1, parent=base)
    return tmp_path, base, grown, [*demos, *fixes, copy]


def test_lerobot_reads_every_frame_as_it_was_recorded(opened, versions, frames, task):
    store, base, grown, episodes = versions
    for version in (base, grown):
        data = opened(store / version.path)
        chosen = episodes[:len(version.episodes)]
        assert (data.fps, data.num_episodes, data.num_frames) == (20, len(chosen), sum(e.frames for e in chosen))
        table = data.hf_dataset.with_format("numpy")[:]
        for name in FEATURES:
            recorded = np.concatenate([frames(e).columns()[name] for e in chosen])
            np.testing.assert_array_equal(np.stack(table[name]), recorded, strict=True)
        ticks = np.concatenate([np.arange(e.frames) for e in chosen])
        np.testing.assert_array_equal(table["frame_index"], ticks)
        np.testing.assert_array_equal(table["timestamp"], (ticks / 20).astype(np.float32))
        np.testing.assert_array_equal(table["index"], np.arange(len(ticks)))
        np.testing.assert_array_equal(
            table["intervention"], np.concatenate([np.arange(e.frames) >= 6 if e.origin == "corrected" else
                                                   np.zeros(e.frames, bool) for e in chosen]))
        assert data[0]["task"] == task


def test_a_chunk_of_16_actions_is_what_our_loader_gives(opened, versions):
    store, _, grown, _ = versions
    data = opened(store / grown.path, delta_timestamps={"action": [k / 20 for k in range(16)]})
    ours = TrainingData.load(store / grown.path)
    for k in np.flatnonzero(ours.last >= 0)[::3]:
        theirs, mine = data[int(k)], ours.gather(np.array([k]), 16)
        np.testing.assert_array_equal(theirs["action"].numpy(), mine.actions[0])
        np.testing.assert_array_equal(theirs["action_is_pad"].numpy(), ~mine.mask[0])
        np.testing.assert_array_equal(theirs["observation.state"].numpy(), mine.state[0])


@pytest.fixture
def filmed(episode, frames, footage, recipe, task, tmp_path):
    """A version with two cameras, one of which repeats pictures; and its folder."""
    demos = [episode(f"demo {k}", length=6 + k) for k in range(3)]
    config = DatasetConfig(cameras={"front": CameraConfig(), "late": CameraConfig(width=32, height=16)})
    with_cameras = recipe.model_copy(update={"dataset": config})
    version = build(demos, frames, with_cameras, store=tmp_path, task=task, generation=0, footage=footage)
    return tmp_path / version.path


def test_lerobot_gives_the_samples_of_our_loader_pictures_too(opened, filmed):
    import torch
    from torch.utils.data import default_collate

    from pipeline.policies.batches import batches, lerobot_batch

    asked = {"action": range(4), "observation.images.front": (-1, 0)}
    data = opened(filmed, delta_timestamps={name: [k / 20 for k in deltas] for name, deltas in asked.items()})
    ours, rows = Samples.load(filmed), np.arange(0, len(data), 2)
    found = ours.gather(rows, asked)
    mine, theirs = lerobot_batch(found, ours.task_of(found)), default_collate([data[int(k)] for k in rows])
    assert mine.keys() == theirs.keys()
    for name, value in theirs.items():
        if name == "task":
            assert mine[name] == value
        else:
            assert (mine[name].dtype, mine[name].shape) == (value.dtype, value.shape), name
            assert torch.equal(mine[name], value), name
    drawn = next(batches(ours, 0, 3, asked, skip=2))
    assert drawn["observation.images.late"].shape == (3, 3, 16, 32) and drawn.keys() == theirs.keys()
    assert data.meta.stats["observation.images.front"]["q99"].shape == (3, 1, 1)
    assert data.meta.camera_keys == ["observation.images.front", "observation.images.late"]


def test_lerobots_own_tools_take_a_version_with_cameras(opened, filmed, tmp_path):
    from lerobot.datasets.dataset_tools import delete_episodes

    less = delete_episodes(opened(filmed), [1], output_dir=tmp_path / "less", repo_id="hardcase/less")
    assert less.num_episodes == 2
    assert load_version(filmed).id == filmed.name


def test_a_stock_policy_with_a_camera_trains_from_our_batches(opened, filmed):
    import torch
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.factory import make_policy, make_pre_post_processors

    from pipeline.policies.batches import batches

    data, asked = opened(filmed), {"action": range(4)}
    small = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 16, "n_encoder_layers": 1, "n_vae_encoder_layers": 1,
             "chunk_size": 4, "n_action_steps": 4, "use_vae": False, "pretrained_backbone_weights": None}
    policy = make_policy(ACTConfig(device="cpu", push_to_hub=False, **small), ds_meta=data.meta)
    before, _ = make_pre_post_processors(policy.config, dataset_stats=data.meta.stats)
    optimiser, losses = torch.optim.AdamW(policy.parameters(), 1e-3), []
    source = batches(Samples.load(filmed, cameras=["front", "late"]), 0, 4, asked)
    for _ in range(8):
        loss, _ = policy.forward(before(next(source)))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert np.isfinite(losses).all() and np.mean(losses[-3:]) < np.mean(losses[:3])


def test_lerobot_can_train_on_the_train_split_alone(opened, versions):
    store, _, grown, _ = versions
    data = opened(store / grown.path, episode_filter=lambda row: row["split"] == "train")
    chosen = {grown.episodes[k] for k in data.episodes}
    assert chosen == set(grown.episodes) - set(grown.held_out) != set(grown.episodes)


def test_the_episodes_table_says_where_each_episode_comes_from(opened, versions):
    store, _, grown, episodes = versions
    rows = list(opened(store / grown.path).meta.episodes)
    fields = ("episode_id", "source", "parent", "outcome", "stratum", "generation", "transform", "policy")
    assert [tuple(row[f] for f in fields) for row in rows] == [
        (e.id, e.origin, e.parent, "success", "common", e.generation, e.transform, None) for e in episodes]
    assert [row["lineage"] for row in rows][-1] == episodes[0].id
    assert sum(row["weight"] for row in rows) == pytest.approx(1)


def test_statistics_are_those_of_every_value(opened, versions, frames):
    store, _, grown, episodes = versions
    data = opened(store / grown.path)
    table = pq.read_table(store / grown.path / "meta/episodes/chunk-000/file-000.parquet")
    for name in FEATURES:
        arrays = [frames(e).columns()[name].astype(np.float64) for e in episodes]
        whole = np.concatenate(arrays)
        for key, expected in expected_statistics(whole).items():
            np.testing.assert_allclose(data.meta.stats[name][key], expected, rtol=1e-12, atol=1e-15, err_msg=key)
        assert data.meta.stats[name]["count"].tolist() == [len(whole)]
        for k, array in enumerate(arrays):
            for key, expected in expected_statistics(array).items():
                np.testing.assert_allclose(table[f"stats/{name}/{key}"][k].as_py(), expected, rtol=1e-12, atol=1e-15)


def expected_statistics(x):
    return {"min": x.min(0), "max": x.max(0), "mean": x.mean(0), "std": x.std(0)} | {
        f"q{round(q * 100):02d}": np.quantile(x, q, axis=0) for q in (0.01, 0.1, 0.5, 0.9, 0.99)}


def test_lerobots_own_tools_take_a_version(opened, versions, tmp_path):
    """Dropping an episode with lerobot's tool reads every table and all statistics that we wrote."""
    from lerobot.datasets.dataset_tools import delete_episodes
    store, base, _, _ = versions
    less = delete_episodes(opened(store / base.path), [1], output_dir=tmp_path / "less", repo_id="hardcase/less")
    assert less.num_episodes == len(base.episodes) - 1
    assert load_version(store / base.path) == base


def test_a_version_of_many_files_and_chunks_is_one_dataset(
        opened, episode, frames, recipe, task, tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.lerobot_view.layout.DATA_FILE_MB", 0.01)  # 56 frames a file
    monkeypatch.setattr("pipeline.lerobot_view.layout.FILES_PER_CHUNK", 3)
    demos = [episode(f"demo {k}", length=25) for k in range(13)]
    base = build(demos[:9], frames, recipe, store=tmp_path, task=task, generation=0)
    grown = build(demos, frames, recipe, store=tmp_path, task=task, generation=1, parent=base)
    folder = tmp_path / grown.path
    assert [f"{p.parent.name[-1]}/{p.stem[-1]}" for p in sorted(folder.glob("data/*/*"))] == [
        "0/0", "0/1", "0/2", "1/0", "1/1", "1/2", "2/0"]
    check_invariants(folder)
    recorded = np.concatenate([frames(d).action for d in demos])
    np.testing.assert_array_equal(np.stack(opened(folder).hf_dataset.with_format("numpy")[:]["action"]), recorded)
    np.testing.assert_array_equal(TrainingData.load(folder).action, recorded)


def test_lerobot_opens_what_was_derived(opened, versions, frames):
    store, _, grown, episodes = versions
    edits = [Drop(episodes=(episodes[2].id, episodes[8].id)), Trim(episode=episodes[4].id, start=3, stop=9),
             Relabel(episode=episodes[0].id, outcome="failure"), Reweight(episodes=(episodes[1].id,), factor=2)]
    made = derive(grown, edits, store=store)
    kept = [(e, slice(3, 9) if e is episodes[4] else slice(None)) for k, e in enumerate(episodes) if k not in (2, 8)]
    check_invariants(store / made.path)
    table = opened(store / made.path).hf_dataset.with_format("numpy")[:]
    np.testing.assert_array_equal(np.stack(table["action"]), np.concatenate([frames(e).action[at] for e, at in kept]))


def check_invariants(folder):
    """Every rule of the format that lerobot relies on but does not check."""
    info = json.loads((folder / "meta/info.json").read_text())
    files = sorted(folder.glob("data/*/*.parquet"))
    rows = pd.concat([pd.read_parquet(f) for f in files], ignore_index=True)
    episodes = pd.read_parquet(folder / "meta/episodes")
    tasks = pd.read_parquet(folder / "meta/tasks.parquet")
    assert list(rows.columns) == list(info["features"])
    assert (rows["index"] == np.arange(len(rows))).all() and len(rows) == info["total_frames"]
    assert (episodes["episode_index"] == np.arange(info["total_episodes"])).all()
    assert (episodes["dataset_from_index"] == [0, *episodes["dataset_to_index"][:-1]]).all()
    assert (episodes["length"] == episodes["dataset_to_index"] - episodes["dataset_from_index"]).all()
    assert (rows["episode_index"] == np.repeat(episodes["episode_index"].to_numpy(), episodes["length"])).all()
    assert tasks.index.name == "task" and (tasks["task_index"] == np.arange(info["total_tasks"])).all()
    assert info["splits"] == {"train": f"0:{len(episodes)}"}
    for file in files:
        here = episodes[(episodes["data/file_index"] == int(file.stem[-3:]))
                        & (episodes["data/chunk_index"] == int(file.parent.name[-3:]))]
        parquet = pq.ParquetFile(file)
        assert [parquet.metadata.row_group(k).num_rows for k in range(parquet.num_row_groups)] == list(here["length"])
        assert parquet.schema_arrow.field("action").type.list_size == 5
    return episodes


@st.composite
def histories(draw):
    """What each generation adds, as lengths of new episodes, and which old ones it drops."""
    rounds = draw(st.integers(1, 4))
    return [(draw(st.lists(st.integers(1, 20), min_size=r == 0, max_size=5)), draw(st.sets(st.integers(0, 12))))
            for r in range(rounds)]


@settings(deadline=None, max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(history=histories())
def test_any_history_of_versions_keeps_the_rules_of_the_format(
        opened, episode, frames, recipe, task, tmp_path_factory, history):
    store = tmp_path_factory.mktemp("store")
    pool, parent, made = [], None, {}
    for generation, (lengths, drops) in enumerate(history):
        pool = [e for k, e in enumerate(pool) if generation == 0 or k not in drops or k == 0]
        pool += [episode(f"{generation} {k}", length=n) for k, n in enumerate(lengths)]
        parent = build(pool, frames, recipe, store=store, task=task, generation=generation, parent=parent)
        made[parent.id] = parent
        table = check_invariants(store / parent.path)
        assert set(table["episode_id"]) == {e.id for e in pool}
        assert set(table[table["split"] == "held_out"]["episode_id"]) == set(parent.held_out)
    for version in made.values():
        assert load_version(store / version.path) == version
    data = opened(store / parent.path)
    states = np.concatenate([frames(e).state for i in parent.episodes for e in pool if e.id == i])
    np.testing.assert_array_equal(np.stack(data.hf_dataset.with_format("numpy")[:]["observation.state"]), states)


def test_a_stock_policy_learns_the_action_and_leaves_the_joint_targets_alone(opened, versions):
    """lerobot takes every feature that begins with `action` for an output; none of its policies uses a second one."""
    import torch
    from lerobot.configs import FeatureType
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.factory import make_policy, make_pre_post_processors

    store, base, _, _ = versions
    data = opened(store / base.path, delta_timestamps={"action": [k / 20 for k in range(4)]})
    small = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 16, "n_encoder_layers": 1, "n_vae_encoder_layers": 1,
             "chunk_size": 4, "n_action_steps": 4, "dropout": 0.0, "use_vae": False}
    policy = make_policy(ACTConfig(device="cpu", push_to_hub=False, **small), ds_meta=data.meta)
    outputs = {name: feature.shape for name, feature in policy.config.output_features.items()}
    assert set(policy.config.input_features) == {"observation.state", "observation.environment_state"}
    assert {name: tuple(shape) for name, shape in outputs.items()} == {"action": (5,), "action.joint": (7,)}
    assert tuple(policy.config.action_feature.shape) == (5,)
    assert {f.type for f in policy.config.output_features.values()} == {FeatureType.ACTION}
    before, after = make_pre_post_processors(policy.config, dataset_stats=data.meta.stats)
    batch = torch.utils.data.default_collate([data[k] for k in range(6)])
    joints = (batch["action.joint"], torch.full_like(batch["action.joint"], torch.nan))
    losses = [policy.forward(before({**batch, "action.joint": joint}))[0].item() for joint in joints]
    assert losses[0] == losses[1] and np.isfinite(losses[0])
    seen = {name: batch[name][:1] for name in policy.config.input_features}
    assert tuple(after(policy.select_action(before(seen))).shape) == (1, 5)


def test_lerobot_knows_the_length_that_an_attempt_at_the_task_has(opened):
    from pipeline.policies.lerobot_env import HardcaseEnv
    from pipeline.simulation.tasks import load_task

    ticks = load_task("pick-place").ticks
    assert HardcaseEnv().episode_length == HardcaseEnv().gym_kwargs["max_episode_steps"] == ticks
    ((env,),) = (made.values() for made in HardcaseEnv().create_envs(1).values())
    assert env.call("_max_episode_steps") == (ticks,)
    env.close()
