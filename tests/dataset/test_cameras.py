"""Versions with cameras: one video an episode and camera, exact, shared, and never missing a picture."""

import json
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from pipeline.errors import ConfigError, DatasetError
from pipeline.lerobot_view.clips import Clips, key_of
from pipeline.lerobot_view.filmed import clips_in
from pipeline.lerobot_view.video import decoded, encode
from pipeline.recipes import recipe_from
from schemas.recipe import CameraConfig, DatasetConfig
from stages.build import build, load_version

ROOT = Path(__file__).parents[2]
FRONT = "observation.images.front"


def contents(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def demos(episode):
    return [episode(f"demo {k}", length=5 + k) for k in range(3)]


@pytest.fixture
def make(recipe, task, tmp_path, frames, footage):
    def make(episodes, *cameras, **how):
        wanted = {name: CameraConfig() for name in cameras or ("front",)} | how.pop("wanted", {})
        filmed = recipe.model_copy(update={"dataset": DatasetConfig(cameras=wanted)})
        return build(episodes, frames, filmed, **{"store": tmp_path, "task": task, "generation": 0, "footage": footage,
                                                  **how})
    return make


def test_every_frame_has_its_picture_on_the_grid(make, demos, footage, tmp_path):
    version = make(demos, "front", "top")
    folder = tmp_path / version.path
    for camera in ("front", "top"):
        for k, demo in enumerate(demos):
            file = folder / f"videos/observation.images.{camera}/chunk-000/file-{k:03d}.mp4"
            with av.open(str(file)) as container:
                stream = container.streams.video[0]
                packets = [p for p in container.demux(stream) if p.size]
                assert [p.pts * stream.time_base for p in packets] == [Fraction(t, 20) for t in range(demo.frames)]
                assert packets[0].is_keyframe and stream.codec.canonical_name == "av1"
            shown, meant = np.stack(list(decoded(file))), np.stack(list(footage(demo, camera).pictures()))
            assert shown.shape == meant.shape
            assert np.abs(shown.astype(int) - meant).mean() < 4, "AV1 changes a smooth picture by a few levels"


def test_two_builds_agree_in_id_and_every_byte(make, demos, tmp_path):
    one, two = make(demos, store=tmp_path / "1"), make(demos, store=tmp_path / "2")
    assert one == two
    assert contents(tmp_path / "1" / one.path) == contents(tmp_path / "2" / two.path)


def test_the_encoder_gives_the_same_bytes_at_every_level_of_parallelism(footage, demos, tmp_path):
    written = []
    for level in (1, 2, 4, None):
        encode(footage(demos[2], "front").pictures(), tmp_path / "x.mp4", fps=20, where="here", parallel=level)
        written.append((tmp_path / "x.mp4").read_bytes())
    assert len(set(written)) == 1


def test_statistics_are_those_of_every_pixel(make, demos, footage, tmp_path):
    folder = tmp_path / make(demos).path
    every = [np.stack(list(footage(d, "front").pictures())).reshape(-1, 3) / 255 for d in demos]
    stats = json.loads((folder / "meta/stats.json").read_text())[FRONT]
    table = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet")
    for measure, of in {"min": np.min, "max": np.max, "mean": np.mean, "std": np.std,
                        **{f"q{q:02d}": lambda x, axis, q=q: np.quantile(x, q / 100, axis=axis)
                           for q in (1, 10, 50, 90, 99)}}.items():
        assert np.array(stats[measure]).shape == (3, 1, 1)
        np.testing.assert_allclose(np.ravel(stats[measure]), of(np.concatenate(every), axis=0), rtol=1e-12)
        for k, pixels in enumerate(every):
            mine = table[f"stats/{FRONT}/{measure}"][k].as_py()
            np.testing.assert_allclose(np.ravel(mine), of(pixels, axis=0), rtol=1e-12, atol=1e-15)
    assert stats["count"] == [sum(d.frames for d in demos)]


def test_a_frame_without_a_picture_of_its_own_repeats_the_last_and_says_how_old_it_is(make, demos, footage, tmp_path):
    film = footage(demos[0], "late")
    folder = tmp_path / make(demos, "late").path
    table = pq.read_table(folder / "data/chunk-000/file-000.parquet")
    np.testing.assert_array_equal(table["skew.camera.late"].to_numpy()[:demos[0].frames], film.skew_s)
    assert film.skew_s.max() > 0 and film.repeated > 0
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet")
    assert episodes["repeated.late"].to_pylist() == [footage(d, "late").repeated for d in demos]
    assert json.loads((folder / "meta/info.json").read_text())["features"]["skew.camera.late"]["names"] == ["late"]


def test_what_was_encoded_once_is_never_encoded_again(make, demos, episode, footage, tmp_path):
    first = make(demos)
    more = episode("more", length=4)

    def only_new(e, camera):
        film = footage(e, camera)
        if e.id != more.id:
            film.pictures = lambda: pytest.fail("pictures were read again")
        return film

    grown = make([*demos, more], parent=first, generation=1, footage=only_new)
    without = make([*demos[1:], more], footage=only_new)  # other places, another version, the same videos
    one, two, three = (clips_in(tmp_path / v.path) for v in (first, grown, without))
    for demo in demos[1:]:
        file = one[demo.id, "front"].file
        assert file.samefile(two[demo.id, "front"].file) and file.samefile(three[demo.id, "front"].file)
        assert file.stat().st_mode & 0o222 == 0
    assert [load_version(tmp_path / v.path) for v in (first, grown, without)] == [first, grown, without]


def test_a_video_goes_by_recording_camera_size_and_settings(footage, demos):
    plain = CameraConfig(width=64, height=64)
    keys = {key_of(footage(e, c), w, f) for e, c, w, f in (
        (demos[0], "front", plain, 20), (demos[1], "front", plain, 20), (demos[0], "top", plain, 20),
        (demos[0], "front", CameraConfig(width=64, height=48), 20), (demos[0], "front", plain, 30),
        (demos[0], "front", CameraConfig(width=64, height=64, crop=(0, 0, 32, 32)), 20))}
    assert len(keys) == 6
    assert key_of(footage(demos[0], "front"), plain.model_copy(update={"max_skew_s": 9.0}), 20) in keys


def test_size_and_crop_come_from_the_recipe(make, demos, footage, tmp_path):
    wanted = {"front": CameraConfig(width=32, height=16, crop=(10, 4, 32, 16))}
    folder = tmp_path / make(demos, wanted=wanted).path
    assert json.loads((folder / "meta/info.json").read_text())["features"][FRONT]["shape"] == [16, 32, 3]
    cut = np.stack(list(footage(demos[0], "front").pictures()))[:, 4:20, 10:42]
    seen = np.stack(list(decoded(clips_in(folder)[demos[0].id, "front"].file)))
    assert np.abs(seen.astype(int) - cut).mean() < 5


def test_without_a_size_a_picture_is_made_even(make, demos, tmp_path):
    folder = tmp_path / make(demos, "odd").path
    features = json.loads((folder / "meta/info.json").read_text())["features"]
    assert features["observation.images.odd"]["shape"] == [48, 64, 3]


@pytest.mark.parametrize(("wanted", "line", "mend"), [
    ({"gone": CameraConfig()}, "no picture of camera 'gone'", "leave the episode"),
    ({"front": CameraConfig(crop=(60, 0, 20, 20))}, r"crop \(60, 0, 20, 20\) leaves a picture of 64x48",
     "dataset.cameras"),
    ({"turned": CameraConfig()}, "picture 2 has 48x64, the first 64x48", "width and height"),
    ({"front": CameraConfig(crop=(0, 0, 8, 8))}, "a picture of 8x8, the encoder takes 16x16", "width and height"),
    ({"short": CameraConfig()}, "3 pictures for 5 frames", "leave the episode out"),
    ({"mixed": CameraConfig()}, "camera 'mixed' has 32x32, the episodes before it 64x48", "dataset.cameras.mixed"),
], ids=["no such camera", "crop outside", "size changes", "too small", "too few", "episodes differ"])
def test_pictures_that_cannot_be_used_are_refused_by_name(make, demos, tmp_path, wanted, line, mend):
    with pytest.raises(DatasetError, match=line) as error:
        make(demos, wanted=wanted)
    assert mend in error.value.mend and error.value.where.split(",")[0].startswith("episode")
    assert not list((tmp_path / "versions").glob("*")) and not list((tmp_path / "tmp").glob("*"))


def test_a_recipe_with_cameras_needs_their_pictures(make, demos):
    with pytest.raises(ConfigError, match=r"no pictures of camera 'front' were handed over.*\n.*\n  mend: leave"):
        make(demos, footage=None)


def test_a_changed_video_is_noticed(make, demos, tmp_path):
    version = make(demos)
    file = tmp_path / version.path / f"videos/{FRONT}/chunk-000/file-001.mp4"
    file.chmod(0o644)
    file.write_bytes(file.read_bytes()[:-1] + b"X")
    with pytest.raises(DatasetError, match=r"file-001.mp4 was changed"):
        load_version(tmp_path / version.path)


def test_a_full_disk_ends_the_build_and_leaves_nothing(make, demos, tmp_path):
    script = """
import importlib.util, resource, signal, sys
from pathlib import Path
from schemas.recipe import DatasetConfig, Recipe
from stages.build import build
spec = importlib.util.spec_from_file_location("made", sys.argv[1])
made = importlib.util.module_from_spec(spec); spec.loader.exec_module(made)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (600, 600))
demo, recipe = made.make_episode("demo 0", length=9), Recipe(name="t", dataset=DatasetConfig(cameras={"front": {}}))
from pipeline.lerobot_view.clips import Clips
try:
    Clips(Path(sys.argv[2])).clip(made.footage_of(demo, "front"), recipe.dataset.cameras["front"], fps=20,
                                  part=Path(sys.argv[2]) / "part", where="x")
except OSError as error:
    print(error.errno, sorted(p.name for p in Path(sys.argv[2]).rglob("*")))
"""
    done = subprocess.run([sys.executable, "-c", script, Path(__file__).with_name("conftest.py"), tmp_path], cwd=ROOT,
                          env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "27 []", done.stderr  # EFBIG, which the build tells as a full disk


def test_a_note_without_its_video_is_made_again(footage, demos, tmp_path):
    clips, wanted, how = Clips(tmp_path), CameraConfig(), {"fps": 20, "part": tmp_path / "part", "where": "here"}
    one = clips.clip(footage(demos[0], "front"), wanted, **how)
    whole = one.file.read_bytes()
    one.file.unlink()
    again = clips.clip(footage(demos[0], "front"), wanted, **how)
    assert again.file.read_bytes() == whole and again.sha256 == one.sha256
    assert sorted(p.suffix for p in clips.folder.iterdir()) == [".json", ".mp4"] and not (tmp_path / "part").exists()


def test_the_page_shows_a_recipe_and_imports_that_work():
    page = (ROOT / "docs/cameras.md").read_text(encoding="utf-8")
    shown = yaml.safe_load(page.split("```yaml\n")[1].split("```")[0])["dataset"]
    assert set(DatasetConfig.model_validate(shown).cameras) == {"front", "wrist", "top"}
    lines = [line for line in page.split("```python\n")[1].split("```")[0].split("\n") if line.startswith("from ")]
    for _, module, _, name in map(str.split, lines):
        assert name in (ROOT / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(("camera", "rule"), [
    ({"width": 65, "height": 64}, "multiple of 2"), ({"width": 64}, "give both or none"),
    ({"crop": [0, 0, 0, 5]}, "width and height 1 or more"), ({"width": 8, "height": 8}, "greater than or equal to 16"),
])
def test_a_camera_that_cannot_be_is_refused_by_the_recipe(camera, rule):
    with pytest.raises(ConfigError, match=rule) as error:
        recipe_from({"name": "x", "dataset": {"cameras": {"front": camera}}}, "x.yaml")
    assert "schemas/recipe.py" in error.value.mend


def test_a_recipe_without_cameras_says_what_it_always_said():
    assert "cameras" not in DatasetConfig().model_dump(mode="json")
