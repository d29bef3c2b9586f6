"""Datasets of ours and of anybody: what is wrong with them, one fault at a time."""

import json
import shutil
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.check.contract import completed
from pipeline.check.folder import read_folder
from pipeline.errors import DatasetError
from pipeline.simulation.gym_env import action_space
from pipeline.simulation.world import CONTROL_HZ
from schemas.contract import Contract, Evaluation

DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"


def test_a_clean_version_raises_no_finding(version, findings):
    verdict = findings(version)
    assert verdict.findings == ()
    assert {"duplicates", "leaks", "evaluation", "statistics", "tables", "lag", "finite"} <= set(verdict.checks)


def test_a_clean_folder_of_somebody_else_raises_no_finding(folder, findings):
    verdict = findings(folder)
    assert verdict.findings == () and verdict.skipped["evaluation"] == "no evaluation in the contract"


def test_a_version_of_ours_is_held_against_its_own_environment(version):
    task = completed(Contract(), read_folder(version)).evaluation
    space = action_space()
    assert task is not None and task.control_hz == CONTROL_HZ
    assert np.allclose(task.action_low, space.low) and np.allclose(task.action_high, space.high)


def rows_of(columns, episode):
    return [k for k, e in enumerate(columns["episode_index"]) if e == episode]


def copy_episode(columns, source, target):
    """Lay the frames of one episode over another one, as far as both go."""
    for a, b in zip(rows_of(columns, source), rows_of(columns, target), strict=False):
        for name in ("observation.state", "observation.environment_state", "action", "action.joint"):
            columns[name][b] = columns[name][a]


def with_nan(columns):
    columns["observation.state"][7] = [float("nan"), *columns["observation.state"][7][1:]]


def with_duplicate(columns):
    copy_episode(columns, 0, 2)


def with_shifted_actions(columns):
    for episode in set(columns["episode_index"]):
        rows = rows_of(columns, episode)
        for name in ("action", "action.joint"):
            values = [columns[name][k] for k in rows]
            for k, value in zip(rows, [*values[:1] * 8, *values[:-8]], strict=True):
                columns[name][k] = value


def in_degrees(columns):
    columns["observation.state"] = [[*np.degrees(row[:6]), *row[6:]] for row in columns["observation.state"]]


def with_index_gap(columns):
    columns["index"] = [k + (k > 20) for k in columns["index"]]


def with_wrong_times(columns):
    columns["timestamp"] = [t * 1.5 for t in columns["timestamp"]]


@pytest.mark.parametrize(("change", "check", "says"), [
    (with_nan, "finite", "joint1 is NaN at frame 7"),
    (with_duplicate, "duplicates", "of its rows with episode 0"),
    (with_shifted_actions, "lag", "runs ahead of action"),
    (in_degrees, "units", "joint3 looks like degrees"),
    (with_index_gap, "tables", "index of row 21 is 22"),
    (with_wrong_times, "tables", "timestamp of row"),
], ids=lambda value: value.__name__ if callable(value) else None)
def test_spoiled_rows_are_found(change, check, says, folder, edit_table, findings):
    edit_table(folder / DATA, change)
    verdict = findings(folder)
    assert not verdict.passed
    assert any(says in f.what for f in verdict.findings if f.check == check), [f.line() for f in verdict.findings]


def test_rows_that_no_longer_fit_the_statistics_are_found(folder, edit_json, findings):
    edit_json(folder / "meta/stats.json", lambda stats: stats["action"]["mean"].__setitem__(0, 0.5))
    found = findings(folder).findings
    assert [f.check for f in found] == ["statistics"] and "mean of value 0 is 0.5" in found[0].what


def test_a_leak_by_descent_is_found(folder, edit_table, findings):
    def leak(columns):
        held = columns["split"].index("held_out")
        columns["lineage"][held] = columns["lineage"][columns["split"].index("train")]

    edit_table(folder / EPISODES, leak)
    assert [f.check for f in findings(folder).findings] == ["leaks"]


def test_a_leak_by_content_is_found(folder, edit_table, findings):
    import pyarrow.parquet as pq

    splits = pq.read_table(folder / EPISODES).column("split").to_pylist()
    edit_table(folder / DATA, lambda columns: copy_episode(columns, splits.index("train"), splits.index("held_out")))
    found = {f.check: f.what for f in findings(folder).findings}
    assert "held_out" in found["leaks"] and "which is in train" in found["leaks"]


def test_splits_of_a_folder_of_somebody_else_are_read_from_its_info(folder, edit_json, edit_table, findings):
    def no_split_of_ours(columns):
        del columns["split"], columns["lineage"]

    edit_table(folder / EPISODES, no_split_of_ours)
    edit_json(folder / "meta/info.json", lambda info: info.update(splits={"train": "0:4", "val": "4:6"}))
    assert findings(folder).findings == ()
    edit_table(folder / DATA, lambda columns: copy_episode(columns, 1, 5))
    found = {f.check: f.what for f in findings(folder).findings}
    assert found["leaks"].startswith("is in val and") and "episode 1, which is in train" in found["leaks"]


def test_a_wrong_success_flag_in_the_table_is_found(folder, edit_table, findings, version):
    edit_table(folder / EPISODES, lambda columns: columns["outcome"].__setitem__(1, "failure"))
    contract = completed(Contract(), read_folder(version)).model_copy(update={"evaluation": None})
    found = findings(folder, contract).findings
    assert [(f.check, f.where) for f in found] == [("success-flag", "episode 1")]


@pytest.mark.parametrize(("wanted", "says"), [
    ({"robot": "other"}, "the robot is arm, the evaluation has other"),
    ({"control_hz": 50}, "the control rate [Hz] is 20.0, the evaluation has 50.0"),
    ({"features": {"observation.images.wrist": ("x",)}}, "feature observation.images.wrist is missing"),
    ({"features": {"action": ("dx", "dy", "dz", "dyaw", "grip")}}, "'gripper' at place 4, the evaluation has 'grip'"),
    ({"action_low": (-1e-3,) * 5, "action_high": (1e-3,) * 5}, "lie outside -0.001 to 0.001"),
], ids=["robot", "rate", "missing feature", "renamed value", "range"])
def test_data_that_does_not_match_the_evaluation_is_found(wanted, says, folder, findings):
    contract = Contract(evaluation=Evaluation(**{"robot": "arm", **wanted}))
    found = [f.what for f in findings(folder, contract).findings if f.check == "evaluation"]
    assert any(says in what for what in found), found


def test_bytes_of_a_version_that_were_changed_are_found(version, findings, tmp_path, edit_json):
    target = tmp_path / "version"
    shutil.copytree(version, target)
    (target / "meta").chmod(0o755)
    edit_json(target / "meta/stats.json", lambda stats: stats["action"]["mean"].__setitem__(0, 0.0))
    found = {f.check: f.what for f in findings(target).findings}
    assert "meta/stats.json was changed after the version was built" in found["tables"]


def add_videos(folder: Path, pictures: dict[int, np.ndarray], lost: int = 0) -> None:
    """Give a dataset a camera: one video an episode, as lerobot lays them; `lost` pictures short in episode 0."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    key = "observation.images.top"
    height, width = pictures[0].shape[1:3]
    info = json.loads((folder / "meta/info.json").read_text())
    info["features"][key] = {"dtype": "video", "shape": [height, width, 3], "names": ["height", "width", "channels"]}
    info["video_path"] = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    (folder / "meta/info.json").write_text(json.dumps(info))
    table = pq.read_table(folder / EPISODES)
    lengths = table.column("length").to_pylist()
    columns = {"chunk_index": [0] * len(lengths), "file_index": list(range(len(lengths))),
               "from_timestamp": [0.0] * len(lengths), "to_timestamp": [n / 20 for n in lengths]}
    for name, values in columns.items():
        table = table.append_column(f"videos/{key}/{name}", pa.array(values))
    pq.write_table(table, folder / EPISODES)
    for k, length in enumerate(lengths):
        path = folder / info["video_path"].format(video_key=key, chunk_index=0, file_index=k)
        path.parent.mkdir(parents=True, exist_ok=True)
        with av.open(str(path), "w") as container:
            stream = container.add_stream("mpeg4", rate=20)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            for frame in pictures[k][:length - (lost if k == 0 else 0)]:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            container.mux(stream.encode())


@pytest.fixture
def filmed(folder, drawn, demos):
    return {k: drawn(k)["top"] for k in range(len(demos))}


def test_a_dataset_with_video_is_clean_where_every_row_has_its_picture(folder, filmed, findings):
    add_videos(folder, filmed)
    verdict = findings(folder)
    assert verdict.findings == () and {"frames", "black-camera", "shifted-video"} <= set(verdict.checks)


def test_pictures_that_an_encoder_dropped_are_found(folder, filmed, findings):
    add_videos(folder, filmed, lost=3)
    found = next(f for f in findings(folder).findings if f.check == "frames")
    assert found.where == "episode 0 observation.images.top" and found.value == found.limit - 3


def test_a_black_video_is_found(folder, filmed, findings):
    add_videos(folder, {**filmed, 2: np.zeros_like(filmed[2])})
    found = next(f for f in findings(folder).findings if f.check == "black-camera")
    assert found.where.startswith("episode 2")


@pytest.mark.parametrize(("spoil", "says"), [
    (lambda f: (f / "meta/info.json").write_text("{"), "meta/info.json cannot be read"),
    (lambda f: shutil.rmtree(f / "data"), "there are no data files"),
    (lambda f: (f / DATA).write_bytes(b"PAR1"), "dataset is damaged"),
    (lambda f: shutil.rmtree(f / "meta/episodes"), "the table of episodes is missing"),
    (lambda f: (f / "meta/info.json").write_text('{"codebase_version": "v2.1"}'), "format 'v2.1', v3.0 is read"),
], ids=["info", "no data", "torn data", "no episodes", "old format"])
def test_a_folder_that_cannot_be_read_is_refused_in_one_line(spoil, says, folder):
    spoil(folder)
    with pytest.raises(DatasetError) as refused:
        read_folder(folder)
    assert says in refused.value.what and refused.value.mend
