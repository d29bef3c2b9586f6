"""Any sequence of edits ends in a dataset that keeps every rule of the format."""

import json

import numpy as np
import pandas as pd
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import DatasetError
from pipeline.lerobot_view.training_data import TrainingData
from schemas.edits import Add, Drop, Relabel, Reweight, Trim
from stages.build import build, load_version
from stages.derive import derive

steps = st.lists(st.tuples(st.sampled_from(["drop", "add", "trim", "relabel", "reweight"]), st.randoms()), min_size=1,
                 max_size=6)


def an_edit(kind, random, held, other):
    """A legal edit of that kind over the episodes that are there, or None; `held` is (id, first frame, after last)."""
    if kind == "add":
        new = [e for e in other.episodes if e not in {id for id, *_ in held}]
        return Add(version=other.id, episodes=tuple(random.sample(new, random.randint(1, len(new)))),
                   share=random.choice([None, 0.25])) if new else None
    id, start, stop = random.choice(held)
    if kind == "drop":
        return Drop(episodes=tuple(e for e, *_ in random.sample(held, random.randint(1, max(1, len(held) // 3)))))
    if kind == "trim":
        first = random.randint(0, stop - start - 1)
        return Trim(episode=id, start=first, stop=random.randint(first + 1, stop - start))
    if kind == "relabel":
        return Relabel(episode=id, outcome=random.choice(["success", "failure", "unknown"]))
    return Reweight(episodes=(id,), factor=random.choice([0.5, 2, 3]))


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
@given(steps=steps)
def test_every_sequence_of_edits_keeps_the_invariants(steps, episode, frames, recipe, task, tmp_path_factory):
    store = tmp_path_factory.mktemp("store")
    demos, news = ([episode(f"{name} {k}", length=4 + k) for k in range(count)] for name, count in (
        ("demo", 6), ("new", 3)))
    version = build(demos, frames, recipe, store=store, task=task, generation=0)
    other = build(news, frames, recipe, store=store, task="push the cube", generation=0)
    by_id = {e.id: e for e in [*demos, *news]}
    held = [(e.id, 0, e.frames) for e in demos]
    for kind, random in steps:
        if (edit := an_edit(kind, random, held, other)) is None:
            continue
        try:
            version = derive(version, [edit], store=store, others={other.id: other})
        except DatasetError as error:
            assert "held out" in error.what or "no episode is left" in error.what
            continue
        held = expected(held, edit, by_id)
    check(store / version.path, version, held, by_id, frames)


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
    assert load_version(folder) == version
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
    action = np.concatenate([frames(by_id[e]).action[a:b] for e, a, b in held])
    np.testing.assert_array_equal(np.stack(rows["action"]), action)
    stats = json.loads((folder / "meta/stats.json").read_text())["action"]
    np.testing.assert_allclose(stats["mean"], action.astype(np.float64).mean(0), rtol=1e-12)
    np.testing.assert_allclose(stats["q90"], np.quantile(action.astype(np.float64), 0.9, axis=0), rtol=1e-12)
    assert sum(version.weights.values()) == np.float64(1).item() or abs(sum(version.weights.values()) - 1) < 1e-9
    assert abs(table["weight"].sum() - 1) < 1e-9
    TrainingData.load(folder).sample(np.random.default_rng(0), 16, 4)
