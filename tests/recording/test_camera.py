"""Pictures read back from recordings: which one each frame shows, and what is refused."""

import json

import numpy as np
import pytest

from flows.run.footage import footage_of, shown
from pipeline.errors import DatasetError
from pipeline.lerobot_view.filmed import clips_in
from pipeline.lerobot_view.video import decoded
from pipeline.recording import read_frames
from pipeline.recording.camera import RecordedFootage
from pipeline.recording.live import LiveRecorder
from pipeline.recording.pictures import jpeg
from pipeline.store import Store
from schemas.episode import Outcome
from schemas.recipe import CameraConfig, DatasetConfig, Recipe
from stages.build import build

TICK_NS = 50_000_000
SUCCESS = Outcome(label="success", judged_by="operator")


def picture(k):
    return np.full((48, 64, 3), 3 * k + 30, np.uint8)


@pytest.fixture
def film(tmp_path, trace, start, row, attachments):
    """Records 60 ticks; `taken` says for which ticks the camera took a picture, `late_ns` how long before the tick."""
    def film(taken, *, late_ns=0, damaged=-1, name="a.mcap", head=start):
        with LiveRecorder(tmp_path / name, head(), attachments=attachments) as recorder:
            base = recorder.now()
            for tick in range(60):
                if tick in taken:
                    data = jpeg(picture(tick))
                    recorder.image("front", data[:300] if tick == damaged else data, tick=tick,
                                   stamp_ns=base + tick * TICK_NS - late_ns)
                recorder.tick(tick, row(trace(), tick), stamp_ns=base + tick * TICK_NS)
            return recorder.close(SUCCESS).path
    return film


def opened(path, max_skew_s=0.5, camera="front"):
    return RecordedFootage(path, camera, 60, blob="ab" * 32, max_skew_s=max_skew_s)


def levels(footage):
    return [round(p.mean()) for p in footage.pictures()]


def test_every_frame_shows_its_own_picture_and_says_how_old_it_is(film):
    footage = opened(film(range(60), late_ns=7_000_000))
    assert levels(footage) == [3 * k + 30 for k in range(60)]
    np.testing.assert_allclose(footage.skew_s, 0.007, atol=1e-6)
    assert footage.repeated == 0


def test_a_frame_without_one_shows_the_last_again_and_never_one_that_came_later(film):
    taken = [k for k in range(60) if k % 4 != 2 and k != 31]
    footage = opened(film(taken))
    last = [max(t for t in taken if t <= k) for k in range(60)]
    assert levels(footage) == [3 * k + 30 for k in last]
    np.testing.assert_allclose(footage.skew_s, [(k - t) / 20 for k, t in enumerate(last)], atol=1e-6)
    assert footage.repeated == 60 - len(taken)


def test_the_source_tells_apart_what_would_be_another_video(film):
    one, again = opened(film(range(60))), opened(film(range(60), name="b.mcap"))
    fewer = opened(film(range(0, 60, 2), name="c.mcap"))
    assert one.source == again.source != fewer.source


@pytest.mark.parametrize(("taken", "line"), [
    ([], "the recording has no picture of camera 'front'"),
    (range(5, 60), "the first picture of camera 'front' belongs to tick 5, frame 0 has none"),
    ([k for k in range(60) if not 20 < k < 35], "frame 31 would show a picture of camera 'front' that is 0.55 s old"),
], ids=["no camera", "none at the start", "too old"])
def test_a_recording_without_admissible_pictures_is_refused(film, taken, line):
    with pytest.raises(DatasetError, match=line) as error:
        opened(film(taken))
    assert "a.mcap, /camera/front" in error.value.where and "hardcase film" in error.value.mend


def test_a_damaged_picture_is_named(film):
    footage = opened(film(range(60), damaged=17))
    with pytest.raises(DatasetError, match="a picture cannot be decoded") as error:
        list(footage.pictures())
    assert "picture 17" in error.value.where


def test_a_recording_of_the_store_becomes_a_version_with_its_camera(film, start, tmp_path):
    path = film([k for k in range(60) if k % 10 != 9])
    dark = film([], name="dark.mcap", head=lambda: start().model_copy(update={"id": "0" * 15 + "1"}))
    recipe = Recipe(name="filmed", dataset=DatasetConfig(cameras={"front": CameraConfig(width=32, height=16)}))
    with Store.open(tmp_path / "store", create=True) as store:
        episodes = []
        for file in (path, dark):
            sha = store.put_blob(file)
            episodes.append(read_frames(store.blob(sha))[0].model_copy(update={"blob": sha}))
        footage = footage_of(store, recipe)
        seen = shown(episodes, footage, recipe)
        assert seen == episodes[:1]
        with pytest.raises(DatasetError, match="no picture of camera 'front'") as error:
            shown(episodes[1:], footage, recipe)
        assert episodes[1].id in error.value.where
        version = build(seen, lambda e: read_frames(store.blob(e.blob))[1], recipe, store=store.root, task="pick",
                        generation=0, footage=footage)
        folder = store.path(version.path)
    clip = clips_in(folder)[episodes[0].id, "front"]
    assert (clip.frames, clip.repeated, clip.width, clip.height) == (60, 6, 32, 16)
    meant = [3 * (k - (k % 10 == 9)) + 30 for k in range(60)]
    np.testing.assert_allclose([p.mean() for p in decoded(clip.file)], meant, atol=2.5)
    said = json.loads((folder / "meta/hardcase.json").read_text())["recipe"]["dataset"]["cameras"]
    assert said["front"]["width"] == 32
