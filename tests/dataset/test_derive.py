"""Versions that are derived from others: what is shared, what changes, what is refused."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.errors import DatasetError
from pipeline.lerobot_view.training_data import TrainingData
from schemas.edits import Add, Drop, Relabel, Reweight, Trim
from stages.build import build, load_version
from stages.derive import derive

EPISODES = "meta/episodes/chunk-000/file-000.parquet"
DATA = "data/chunk-000/file-000.parquet"


@pytest.fixture
def base(episode, frames, recipe, task, tmp_path):
    """Ten demonstrations and two corrections, in one version; with the episodes."""
    demos = [episode(f"demo {k}", length=9 + k) for k in range(10)]
    fixes = [episode(f"fix {k}", "corrected", parent=f"attempt {k}", generation=1, length=20, takeover=6)
             for k in range(2)]
    return build([*demos, *fixes], frames, recipe, store=tmp_path, task=task, generation=1), [*demos, *fixes]


def table(store, version):
    return pq.read_table(store / version.path / EPISODES).to_pydict()


def test_dropping_leaves_the_other_frames_as_they_were(base, frames, tmp_path):
    version, episodes = base
    gone = episodes[2], episodes[7]
    less = derive(version, [Drop(episodes=tuple(e.id for e in gone))], store=tmp_path)
    kept = [e for e in episodes if e not in gone]
    assert less.episodes == tuple(e.id for e in kept) and less.parent == version.id
    data = TrainingData.load(tmp_path / less.path)
    np.testing.assert_array_equal(data.action, np.concatenate([frames(e).action for e in kept]))
    assert load_version(tmp_path / less.path) == less
    assert load_version(tmp_path / version.path) == version


def test_a_derived_version_is_the_one_that_would_have_been_built(base, episode, frames, recipe, task, tmp_path):
    """Dropping from a version gives the tables of a version that never had the episode, statistics included."""
    version, episodes = base
    less = derive(version, [Drop(episodes=(episodes[3].id,))], store=tmp_path)
    kept = [e for e in episodes if e.id != episodes[3].id]
    afresh = build(kept, frames, recipe, store=tmp_path / "afresh", task=task, generation=1)
    for file in ("meta/stats.json", "meta/info.json", "meta/tasks.parquet"):
        assert (tmp_path / less.path / file).read_bytes() == (tmp_path / "afresh" / afresh.path / file).read_bytes()
    assert pq.read_table(tmp_path / less.path / DATA).equals(pq.read_table(tmp_path / "afresh" / afresh.path / DATA))
    mine, theirs = table(tmp_path, less), table(tmp_path / "afresh", afresh)
    assert {k: v for k, v in mine.items() if k not in ("split", "weight")} == {
        k: v for k, v in theirs.items() if k not in ("split", "weight")}


def test_what_did_not_change_is_shared_and_cannot_be_written(base, tmp_path):
    version, episodes = base
    other = derive(version, [Relabel(episode=episodes[0].id, outcome="failure")], store=tmp_path)
    for file in (DATA, "meta/stats.json"):
        shared = tmp_path / other.path / file
        assert shared.samefile(tmp_path / version.path / file)
        assert not shared.stat().st_mode & 0o222
    assert table(tmp_path, other)["outcome"][:2] == ["failure", "success"]


def test_the_same_edits_give_the_same_version_and_others_another(base, tmp_path):
    version, episodes = base
    edits = [Drop(episodes=(episodes[1].id,)), Trim(episode=episodes[2].id, start=1, stop=5)]
    first = derive(version, edits, store=tmp_path)
    assert derive(version, edits, store=tmp_path) == first
    assert derive(version, edits[:1], store=tmp_path).id != first.id
    assert first.edits == tuple(edits)


def test_a_trimmed_episode_keeps_the_frames_between(base, frames, tmp_path):
    version, episodes = base
    cut = derive(version, [Trim(episode=episodes[0].id, start=2, stop=7)], store=tmp_path)
    rows = pq.read_table(tmp_path / cut.path / DATA).slice(0, 5).to_pydict()
    np.testing.assert_array_equal(np.stack(rows["action"]), frames(episodes[0]).action[2:7])
    assert rows["frame_index"] == [0, 1, 2, 3, 4] and rows["timestamp"][1] == pytest.approx(0.05)
    assert (table(tmp_path, cut)["length"][0], cut.frames) == (5, version.frames - 4)


def test_a_trim_of_a_trim_counts_from_what_is_left(base, frames, tmp_path):
    version, episodes = base
    once = derive(version, [Trim(episode=episodes[5].id, start=2, stop=10)], store=tmp_path)
    twice = derive(once, [Trim(episode=episodes[5].id, start=1, stop=4)], store=tmp_path)
    at = table(tmp_path, twice)["dataset_from_index"][5]
    rows = pq.read_table(tmp_path / twice.path / DATA).slice(at, 3).to_pydict()
    np.testing.assert_array_equal(np.stack(rows["action"]), frames(episodes[5]).action[3:6])


def test_a_trim_that_cuts_off_the_intervention_is_refused(base, tmp_path):
    version, episodes = base
    with pytest.raises(DatasetError, match=r"hold nothing of the intervention(.|\n)*trim around the intervention"):
        derive(version, [Trim(episode=episodes[10].id, start=0, stop=5)], store=tmp_path)


def test_reweighted_episodes_are_drawn_so_many_times_as_often(base, tmp_path):
    version, episodes = base
    train = [e for e in episodes[:10] if e.id not in version.held_out]
    heavy = derive(version, [Reweight(episodes=(train[0].id, train[1].id), factor=3.0)], store=tmp_path)
    before, after = (dict(zip(t["episode_id"], t["weight"], strict=True)) for t in (
        table(tmp_path, version), table(tmp_path, heavy)))
    ratio = {e.id: after[e.id] / before[e.id] for e in episodes if before[e.id]}
    assert sum(after.values()) == pytest.approx(1) == sum(heavy.weights.values())
    assert ratio[train[0].id] == pytest.approx(3 * ratio[train[2].id]) == pytest.approx(ratio[train[1].id])
    data = TrainingData.load(tmp_path / heavy.path)
    drawn = np.concatenate([data.sample(np.random.default_rng(k), 1000, 1).state for k in range(20)])
    first = int(data.starts[list(heavy.episodes).index(train[0].id)])
    mine = {row.tobytes() for row in data.state[first:first + train[0].frames]}
    share = sum(row.tobytes() in mine for row in drawn) / len(drawn)
    assert share == pytest.approx(after[train[0].id], abs=0.01)


def test_episodes_of_another_version_come_in_whole(base, episode, frames, recipe, task, tmp_path):
    version, episodes = base
    news = [episode(f"new {k}", length=14) for k in range(4)]
    other = build(news, frames, recipe, store=tmp_path, task="push the cube", generation=0)
    more = derive(version, [Add(version=other.id, episodes=other.episodes[:3], share=0.25)], store=tmp_path,
                  others={other.id: other})
    data = TrainingData.load(tmp_path / more.path)
    np.testing.assert_array_equal(data.action, np.concatenate([frames(e).action for e in [*episodes, *news[:3]]]))
    assert (tmp_path / more.path / DATA).samefile(tmp_path / version.path / DATA)
    assert sum(w for w, group in zip(*(table(tmp_path, more)[c] for c in ("weight", "group")), strict=True)
               if group == "test") == pytest.approx(0.25)
    assert table(tmp_path, more)["tasks"][-1] == ["push the cube"]
    assert pq.read_table(tmp_path / more.path / "meta/tasks.parquet").column("task").to_pylist() == [
        task, "push the cube"]


def test_a_task_that_nobody_does_any_more_is_gone(episode, frames, recipe, tmp_path):
    demos = [episode(f"demo {k}") for k in range(4)]
    version = build(demos, frames, recipe, store=tmp_path, generation=0,
                    task={e.id: f"task {k % 2}" for k, e in enumerate(demos)})
    less = derive(version, [Drop(episodes=(demos[0].id, demos[2].id))], store=tmp_path)
    rows = pq.read_table(tmp_path / less.path / DATA).to_pydict()
    assert set(rows["task_index"]) == {0}
    assert json.loads((tmp_path / less.path / "meta/info.json").read_text())["total_tasks"] == 1


@pytest.mark.parametrize(("edit", "words"), [
    (lambda e: Drop(episodes=("0" * 16,)), "episode 0000000000000000 is not in the version(.|\n)*use one that is"),
    (lambda e: Drop(episodes=tuple(x.id for x in e)), "no episode is left(.|\n)*keep at least one"),
    (lambda e: Trim(episode=e[0].id, start=0, stop=99), "has 9 frames, 99 were asked for(.|\n)*:0:9 at most"),
], ids=["unknown episode", "nothing left", "too long"])
def test_an_edit_that_cannot_be_done_is_refused(base, tmp_path, edit, words):
    version, episodes = base
    with pytest.raises(DatasetError, match=words):
        derive(version, [edit(episodes)], store=tmp_path)
    assert [p.name for p in (tmp_path / "versions").iterdir()] == [version.id]
    assert not list((tmp_path / "tmp").iterdir())


def test_a_parent_that_was_changed_is_refused(base, tmp_path):
    version, episodes = base
    (tmp_path / version.path / DATA).chmod(0o644)
    (tmp_path / version.path / DATA).write_bytes(b"nothing")
    with pytest.raises(DatasetError, match=r"was changed after the version was built(.|\n)*rm -r"):
        derive(version, [Drop(episodes=(episodes[0].id,))], store=tmp_path)
