"""Derived and imported versions with cameras: nothing is encoded again, every picture stays with its frame."""

import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest

from flows.data.importing import ImportOrder, import_folder
from pipeline.lerobot_view.filmed import clips_in
from pipeline.lerobot_view.video import decoded
from pipeline.store import Store
from schemas.consent import Consent
from schemas.edits import Drop, Trim
from schemas.recipe import CameraConfig, DatasetConfig
from stages.build import build, load_version
from stages.derive import derive

EPISODES = "meta/episodes/chunk-000/file-000.parquet"
FRONT = "observation.images.front"


@pytest.fixture
def filmed(episode, smooth, footage, recipe, task, tmp_path):
    """Four episodes with one camera; with the episodes."""
    demos = [episode(f"demo {k}", length=30 + k) for k in range(4)]
    wanted = recipe.model_copy(update={"dataset": DatasetConfig(cameras={"front": CameraConfig()})})
    return build(demos, smooth, wanted, store=tmp_path, task=task, generation=0, footage=footage), demos


def no_encoder(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("a video was encoded")

    monkeypatch.setattr("pipeline.lerobot_view.video.encode", refuse)


def test_dropping_shares_the_videos_and_their_pixels(filmed, tmp_path, monkeypatch):
    no_encoder(monkeypatch)
    version, demos = filmed
    less = derive(version, [Drop(episodes=(demos[1].id,))], store=tmp_path)
    before, after = clips_in(tmp_path / version.path), clips_in(tmp_path / less.path)
    for demo in (demos[0], demos[2], demos[3]):
        clip = after[demo.id, "front"]
        assert clip.file.samefile(before[demo.id, "front"].file) and not clip.file.stat().st_mode & 0o222
        assert (clip.frames, clip.first) == (demo.frames, 0)
    assert load_version(tmp_path / less.path) == less
    counts = json.loads((tmp_path / less.path / "meta/stats.json").read_text())[FRONT]["count"]
    assert counts == [less.frames] and (demos[1].id, "front") not in after


def test_a_trim_addresses_another_part_of_the_same_video(filmed, tmp_path, monkeypatch):
    no_encoder(monkeypatch)
    version, demos = filmed
    cut = derive(version, [Trim(episode=demos[2].id, start=4, stop=20)], store=tmp_path)
    row = {k: v[2] for k, v in pq.read_table(tmp_path / cut.path / EPISODES).to_pydict().items()}
    assert (row[f"videos/{FRONT}/from_timestamp"], row[f"videos/{FRONT}/to_timestamp"]) == pytest.approx((0.2, 1.0))
    clip = clips_in(tmp_path / cut.path)[demos[2].id, "front"]
    assert clip.file.samefile(clips_in(tmp_path / version.path)[demos[2].id, "front"].file)
    shown = np.stack(list(decoded(clip.file)))[4:20]
    np.testing.assert_allclose(np.ravel(row[f"stats/{FRONT}/mean"]), shown.mean((0, 1, 2)) / 255, rtol=1e-9)


def test_a_foreign_dataset_brings_its_videos_packet_by_packet(filmed, tmp_path):
    version, demos = filmed
    folder = tmp_path / "foreign"
    shutil.copytree(tmp_path / version.path, folder, copy_function=shutil.copyfile)
    for name in ("meta/hardcase.json", "meta/pictures.parquet"):
        (folder / name).unlink()
    with Store.open(tmp_path / "other", create=True, reserve_mb=1) as store:
        store.add_consent(Consent.model_validate({
            "id": "form-1", "operator": "ada", "site": "lab", "purposes": ("training",), "given": "2020-01-01",
            "expires": "2999-12-31"}))
        told = import_folder(ImportOrder(folder, consent="form-1"), tmp_path / "other")
        again = import_folder(ImportOrder(folder, consent="form-1"), tmp_path / "other")
        made = store.version(told["version"])
        assert (told["copied"], told["encoded"], again["version"], again["new"]) == (4, 0, made.id, 0)
        theirs = [clips_in(tmp_path / version.path)[d.id, "front"].file for d in demos]
        mine = [clips_in(store.path(made.path))[e, "front"].file for e in made.episodes]
    for one, two in zip(theirs, mine, strict=True):
        for a, b in zip(decoded(one), decoded(two), strict=True):
            np.testing.assert_array_equal(a, b)
