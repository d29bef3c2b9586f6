"""Any sequence of edits, mergers and erasures ends in a dataset that keeps every rule of the format."""

import json
import subprocess
from collections import Counter
from datetime import UTC, datetime
from itertools import pairwise

import av
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import DatasetError
from pipeline.files import sha256_file
from pipeline.lerobot_view.exact import QUANTILES
from pipeline.lerobot_view.manifest import digest_of, read_manifest
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.store import Store
from pipeline.store.erasure_plan import plan_erasure
from schemas.edits import Add, Drop, Relabel, Reweight, Trim
from schemas.recipe import CameraConfig, DatasetConfig, Recipe
from stages.build import build, load_version
from stages.derive import derive
from stages.forget import forget

pytestmark = pytest.mark.xdist_group("lerobot")  # the process that has imported it

FRONT = "observation.images.front"
KINDS = ("drop", "add", "merge", "trim", "relabel", "reweight", "forget")
steps = st.lists(st.tuples(st.sampled_from(KINDS), st.randoms(use_true_random=False)), min_size=1, max_size=6)


@pytest.fixture(scope="module")
def lerobot_reads(tmp_path_factory):
    """What lerobot says against a folder while it reads every sample of it."""
    patch = pytest.MonkeyPatch()
    for name in ("HF_HOME", "HF_DATASETS_CACHE", "HF_LEROBOT_HOME"):
        patch.setenv(name, str(tmp_path_factory.mktemp(name)))
    patch.setenv("HF_HUB_OFFLINE", "1")
    from pipeline.selftest.with_lerobot import complaints

    yield complaints
    patch.undo()


@pytest.fixture
def stored(episode, frames, footage, task, tmp_path):
    """A store with a version of six episodes and another one of three, of another task, with a camera; and how to
    copy it."""
    recipe = Recipe(name="random", dataset=DatasetConfig(cameras={"front": CameraConfig()}))
    with Store.open(tmp_path / "first", create=True, reserve_mb=1) as store:
        made, by_id = [], {}
        for name, count, words in (("demo", 6, task), ("new", 3, "push the cube")):
            many = [episode(f"{name} {k}", length=4 + k, blob=store.put_blob(f"{name} {k}".encode()))
                    for k in range(count)]
            version = build(many, frames, recipe, store=store.root, task=words, generation=0, footage=footage)
            store.add_version(version, many)
            made.append(version.id)
            by_id |= {e.id: e for e in many}
    return tmp_path, made, by_id


def an_edit(kind, random, held, other):
    """A legal edit of that kind over the episodes that are there, or None; `held` is (id, first frame, after last)."""
    new = [e for e in other.episodes if e not in {id for id, *_ in held}]
    if kind in ("add", "merge"):
        chosen = new if kind == "merge" else random.sample(new, random.randint(1, len(new))) if new else []
        return Add(version=other.id, episodes=tuple(chosen), share=random.choice([None, 0.25])) if chosen else None
    id, start, stop = random.choice(held)
    if kind == "drop":
        return Drop(episodes=tuple(e for e, *_ in random.sample(held, random.randint(1, max(1, len(held) // 3)))))
    if kind == "trim":
        first = random.randint(0, stop - start - 1)
        return Trim(episode=id, start=first, stop=random.randint(first + 1, stop - start))
    if kind == "relabel":
        return Relabel(episode=id, outcome=random.choice(["success", "failure", "unknown"]))
    return Reweight(episodes=(id,), factor=random.choice([0.5, 2, 3]))


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(steps=steps)
def test_every_sequence_of_edits_keeps_the_invariants(steps, stored, frames, lerobot_reads):
    folder, (first, second), by_id = stored
    root = folder / f"copy {len(list(folder.iterdir()))}"
    subprocess.run(["cp", "-a", folder / "first", root], check=True)  # hard links stay hard links
    held, current = [(e.id, 0, e.frames) for e in list(by_id.values())[:6]], first
    with Store.open(root, reserve_mb=1) as store:
        for kind, random in steps:
            if kind == "forget":
                gone = random.choice(held)[0]
                erased(store, gone)
                held = [h for h in held if h[0] != gone]
                if "train" not in sides(store, current):
                    return  # nothing of it is left that could teach
                continue
            if (edit := an_edit(kind, random, held, store.version(second))) is None:
                continue
            try:
                version = derive(store.version(current), [edit], store=root, others={second: store.version(second)})
            except DatasetError as error:
                assert "held out" in error.what or "no episode is left" in error.what
                continue
            store.add_version(version)
            current, held = version.id, expected(held, edit, by_id)
        for version in store.versions():
            assert load_version(root / version.path) == version
        version = store.version(current)
        check(root / version.path, version, held, by_id, frames)
        assert lerobot_reads(root / version.path) == []
        assert store.verify() == []


def erased(store, id):
    plan = plan_erasure(store, id, "asked by the person", datetime(2026, 11, 24, tzinfo=UTC))
    with store.lease(plan.id, erases=True) as lease:
        forget(store, lease, plan)
    assert all(id not in v.episodes for v in store.versions())


def sides(store, id):
    """The splits of the episodes that are left in a version."""
    version = store.version(id)
    return {"held_out" if e in version.held_out else "train" for e in version.episodes}


def expected(held, edit, by_id):
    match edit:
        case Drop():
            return [h for h in held if h[0] not in edit.episodes]
        case Add():
            return held + [(e, 0, by_id[e].frames) for e in edit.episodes]
        case Trim():
            return [(e, a + edit.start, a + edit.stop) if e == edit.episode else (e, a, b) for e, a, b in held]
    return held


def check(folder, version, held, by_id, frames):
    manifest = read_manifest(folder)
    there = {p.relative_to(folder).as_posix(): sha256_file(p) for p in folder.rglob("*") if p.is_file()}
    assert there == {**manifest["files"], "meta/hardcase.json": there["meta/hardcase.json"]}
    assert digest_of(there) == version.digest and set(manifest["version"]["episodes"]) == {e for e, *_ in held}
    info = json.loads((folder / "meta/info.json").read_text())
    rows = pd.concat([pd.read_parquet(f) for f in sorted(folder.glob("data/*/*.parquet"))], ignore_index=True)
    table, tasks = pd.read_parquet(folder / "meta/episodes"), pd.read_parquet(folder / "meta/tasks.parquet")
    assert list(table["episode_id"]) == [e for e, *_ in held] == list(version.episodes)
    assert (rows["index"] == np.arange(len(rows))).all() and len(rows) == info["total_frames"] == version.frames
    assert (table["episode_index"] == np.arange(info["total_episodes"])).all()
    assert (table["dataset_from_index"] == [0, *table["dataset_to_index"][:-1]]).all()
    assert (table["length"] == [b - a for _, a, b in held]).all()
    assert (rows["episode_index"] == np.repeat(table["episode_index"], table["length"]).to_numpy()).all()
    ticks = np.concatenate([np.arange(n) for n in table["length"]])
    assert (rows["frame_index"] == ticks).all() and np.allclose(rows["timestamp"], ticks / info["fps"])
    assert list(tasks["task_index"]) == list(range(info["total_tasks"])) and set(rows["task_index"]) == set(range(
        info["total_tasks"]))
    assert [tasks.index[k] for k in rows["task_index"][table["dataset_from_index"]]] == [t[0] for t in table["tasks"]]
    assert abs(sum(version.weights.values()) - 1) < 1e-9 and abs(table["weight"].sum() - 1) < 1e-9
    numbers(folder, table, held, by_id, frames, rows)
    videos(folder, table, info)
    if not version.erased:  # else it teaches nothing any more
        TrainingData.load(folder).sample(np.random.default_rng(0), 16, 4)


def numbers(folder, table, held, by_id, frames, rows):
    """Every value where it belongs, and statistics that are exact, of the whole and of each episode."""
    parts = [frames(by_id[e]).action[a:b].astype(np.float64) for e, a, b in held]
    np.testing.assert_array_equal(np.stack(rows["action"]), np.concatenate(parts))
    told = json.loads((folder / "meta/stats.json").read_text())["action"]
    each = [{key: table[f"stats/action/{key}"][k] for key in told} for k in range(len(parts))]
    for stats, values in zip([told, *each], [np.concatenate(parts), *parts], strict=True):
        exact = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0),
                 "count": [len(values)]} | {q: np.quantile(values, share, axis=0) for q, share in QUANTILES.items()}
        for key, value in exact.items():
            np.testing.assert_allclose(stats[key], value, rtol=1e-12, atol=1e-15, err_msg=key)


def videos(folder, table, info):
    """The packets of every video are the rows of its episode, on the exact grid."""
    columns = [f"videos/{FRONT}/{what}" for what in ("chunk_index", "file_index", "from_timestamp", "to_timestamp")]
    for (chunk, file, start, stop), length in zip(table[columns].itertuples(index=False), table["length"], strict=True):
        path = folder / info["video_path"].format(video_key=FRONT, chunk_index=chunk, file_index=file)
        with av.open(str(path)) as film:
            base = float(film.streams.video[0].time_base)
            stamps = np.sort([p.pts * base for p in film.demux(video=0) if p.pts is not None])
        inside = stamps[(stamps > start - 1e-4) & (stamps < stop - 1e-4)]
        np.testing.assert_allclose(inside, start + np.arange(length) / info["fps"], atol=1e-4)
    assert max(Counter(table[f"videos/{FRONT}/file_index"]).values()) == 1 and all(
        a < b for a, b in pairwise(table[f"videos/{FRONT}/file_index"]))
