"""Training data: what is drawn, how often, and how chunks end."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.errors import DatasetError
from pipeline.lerobot_view.training_data import TrainingData
from schemas.recipe import DatasetConfig
from stages.build import build

ROOT = Path(__file__).parents[2]


@pytest.fixture
def version(episode, frames, recipe, task, tmp_path):
    """30 demonstrations and 20 corrections taken over at frame 5, and the folder of their version."""
    demos = [episode(f"demo {k}", length=10 + k % 7) for k in range(30)]
    fixes = [episode(f"fix {k}", "corrected", parent=f"attempt {k}", generation=1, length=14, takeover=5)
             for k in range(20)]
    built = build([*demos, *fixes], frames, recipe, store=tmp_path, task=task, generation=1)
    return tmp_path / built.path, [*demos, *fixes], built


def test_the_arrays_are_the_recorded_frames(version, frames):
    folder, episodes, _ = version
    data = TrainingData.load(folder)
    for episode, start, stop in zip(episodes, data.starts, data.stops, strict=True):
        one = frames(episode)
        np.testing.assert_array_equal(data.state[start:stop], one.state)
        np.testing.assert_array_equal(data.environment[start:stop], one.environment)
        np.testing.assert_array_equal(data.action[start:stop], one.action)


def test_a_chunk_repeats_the_last_action_past_the_end_and_says_so(version, frames):
    folder, episodes, _ = version
    data = TrainingData.load(folder)
    batch = data.gather(np.array([data.stops[0] - 3]), 6)
    action = frames(episodes[0]).action
    np.testing.assert_array_equal(batch.actions[0], action[[-3, -2, -1, -1, -1, -1]])
    assert batch.mask[0].tolist() == [True, True, True, False, False, False]
    np.testing.assert_array_equal(batch.state[0], frames(episodes[0]).state[-3])


def test_equal_generators_draw_equal_batches(version):
    folder, *_ = version
    one, two = (TrainingData.load(folder).sample(np.random.default_rng(3), 64, 16) for _ in range(2))
    for ours, theirs in zip(one, two, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert [(a.shape, a.dtype.str) for a in one] == [
        ((64, 16), "<f4"), ((64, 7), "<f4"), ((64, 16, 5), "<f4"), ((64, 16), "|b1")]


def rows_of(data, batch):
    """Which rows of the version the samples start at: every state differs."""
    place = {row.tobytes(): k for k, row in enumerate(data.state)}
    return np.array([place[row.tobytes()] for row in batch.state])


def test_batches_hold_the_groups_in_their_shares_and_nothing_held_out(version):
    folder, episodes, built = version
    data = TrainingData.load(folder)
    rows = rows_of(data, data.sample(np.random.default_rng(0), 20_000, 4))
    drawn = np.searchsorted(data.stops, rows, side="right")
    held = {k for k, e in enumerate(episodes) if e.id in built.held_out}
    assert held and not held & set(drawn.tolist())
    assert (drawn >= 30).mean() == pytest.approx(DatasetConfig().weights["corrections"])
    table = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet", columns=["weight"])
    expected = table.column("weight").to_numpy()
    np.testing.assert_allclose(np.bincount(drawn, minlength=50) / 20_000, expected, atol=0.006)


def test_small_batches_hold_the_shares_on_average(version):
    folder, *_ = version
    data, rng = TrainingData.load(folder), np.random.default_rng(1)
    rows = np.concatenate([rows_of(data, data.sample(rng, 3, 2)) for _ in range(1500)])
    share = DatasetConfig().weights["corrections"]
    assert (np.searchsorted(data.stops, rows, side="right") >= 30).mean() == pytest.approx(share, abs=0.02)


def test_of_a_correction_only_the_intervention_teaches(version):
    folder, episodes, _ = version
    data = TrainingData.load(folder)
    both = np.concatenate([rows_of(data, batch) for batch in (data.training(1), data.held_out(1))])
    offset = both - data.starts[np.searchsorted(data.stops, both, side="right")]
    corrections = np.searchsorted(data.stops, both, side="right") >= 30
    assert set(offset[corrections].tolist()) == set(range(5, 14))
    assert 0 in offset[~corrections] and both.size == sum(e.frames for e in episodes) - 20 * 5


def test_the_validation_split_is_all_of_the_held_out_episodes(version):
    folder, episodes, built = version
    data = TrainingData.load(folder)
    rows = rows_of(data, data.held_out(16))
    assert {episodes[k].id for k in np.searchsorted(data.stops, rows, side="right")} == set(built.held_out)
    assert not set(rows.tolist()) & set(rows_of(data, data.training(16)).tolist())


def test_a_chunk_ends_where_the_policy_took_over_again(episode, frames, recipe, task, tmp_path):
    segments = [{"kind": kind, "start": a, "stop": b, "actor": "stand-in"}
                for kind, a, b in (("autonomous", 0, 3), ("intervention", 3, 6), ("autonomous", 6, 9))]
    handed_back = episode("fix", "corrected", parent="attempt", length=9, generation=1, segments=segments)
    version = build([handed_back], frames, recipe, store=tmp_path, task=task, generation=1)
    batch = TrainingData.load(tmp_path / version.path).training(4)
    assert batch.mask.sum(axis=1).tolist() == [3, 2, 1]
    np.testing.assert_array_equal(batch.actions[1], frames(handed_back).action[[4, 5, 5, 5]])


def test_without_held_out_episodes_the_validation_split_is_empty(episode, frames, recipe, task, tmp_path):
    version = build([episode("only")], frames, recipe, store=tmp_path, task=task, generation=0)
    data = TrainingData.load(tmp_path / version.path)
    assert version.held_out == ()
    assert [a.shape for a in data.held_out(16)] == [(0, 16), (0, 7), (0, 16, 5), (0, 16)]


def test_a_changed_folder_is_never_trained_on(version):
    folder, *_ = version
    path = folder / "data/chunk-000/file-000.parquet"
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[:-1] + b"X")
    with pytest.raises(DatasetError, match=r"file-000.parquet was changed.*\n.*\n  mend: .*hardcase build"):
        TrainingData.load(folder)


def test_building_and_loading_import_neither_torch_nor_lerobot_nor_pandas(tmp_path):
    script = """
import importlib.util, sys
from pathlib import Path
from schemas.recipe import Recipe
from stages.build import build
from pipeline.lerobot_view.training_data import TrainingData
from schemas.recipe import DatasetConfig
spec = importlib.util.spec_from_file_location("made", sys.argv[1])
made = importlib.util.module_from_spec(spec)
spec.loader.exec_module(made)
store, parent = Path(sys.argv[2]), None
for count in (3, 5):
    demos = [made.make_episode(str(k)) for k in range(count)]
    parent = build(demos, made.frames_of, Recipe(name="t"), store=store, task="x", generation=0, parent=parent)
TrainingData.load(store / parent.path)
print([m for m in ("torch", "lerobot", "pandas", "datasets") if m in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", script, Path(__file__).with_name("conftest.py"), tmp_path], cwd=ROOT,
                          env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
