"""Videos and samples with cameras, beside lerobot's defaults doing the same from the same pictures in one run.

Times are CPU seconds of this process and its children, because wall time on a shared machine says little.
Run: pytest tests/bench_cameras.py -s; HARDCASE_BENCH_FULL=1 takes the sizes of docs/results.md, else fewer frames.
"""

import hashlib
import logging
import os
import resource
from pathlib import Path

import numpy as np
import pytest

from pipeline.footage import source_of
from pipeline.frames import FEATURES, FeatureTable
from pipeline.lerobot_view.samples import Samples
from schemas.episode import Episode, Outcome, Segment
from schemas.recipe import CameraConfig, DatasetConfig, Recipe
from schemas.scene import SceneSpec
from stages.build import build

FULL = "HARDCASE_BENCH_FULL" in os.environ
STATE = {name: FEATURES[name] for name in ("observation.state", "action")}
SCENE = SceneSpec(family="demo", seed=1, robot="arm", scene="table", task="pick-place", stratum="common",
                  object_xy_m=(0.3, 0.0), object_yaw_rad=0.1, object_half_m=0.02, target_xy_m=(0.3, 0.1))
CHUNK = 16


def cpu() -> float:
    """CPU seconds of this process, all its threads, and the children that it has waited for."""
    return sum(u.ru_utime + u.ru_stime for u in map(resource.getrusage, (resource.RUSAGE_SELF,
                                                                         resource.RUSAGE_CHILDREN)))


def made(episodes: int, frames: int) -> list[Episode]:
    def digest(k: int) -> str:
        return hashlib.sha256(str(k).encode()).hexdigest()

    return [Episode(id=digest(k)[:16], origin="scripted", scene=SCENE, control_hz=20, frames=frames, generation=0,
                    outcome=Outcome(label="success", judged_by="simulator"), blob=digest(k),
                    segments=(Segment(kind="demonstration", start=0, stop=frames, actor="expert"),))
            for k in range(episodes)]


def filmed(episode: Episode, camera: str, height: int, width: int) -> np.ndarray:
    """A textured table with a disc that moves over it and a little noise, shape (frames, height, width, 3)."""
    rng = np.random.default_rng(int(episode.id, 16) % 2**32 + len(camera))
    coarse = rng.integers(40, 200, (height // 16 + 1, width // 16 + 1, 3)).astype(np.uint8)
    table = np.kron(coarse, np.ones((16, 16, 1), np.uint8))[:height, :width]
    y, x = np.mgrid[:height, :width]
    noise = rng.integers(-3, 4, (height, width, 3))
    pictures = np.empty((episode.frames, height, width, 3), np.uint8)
    for k in range(episode.frames):
        disc = (y - height / 2) ** 2 + (x - width * (0.2 + 0.6 * k / episode.frames)) ** 2 < (height / 6) ** 2
        picture = np.where(disc[..., None], np.array([200, 40, 60]), table) + np.roll(noise, 7 * k, axis=1)
        pictures[k] = np.clip(picture, 0, 255)
    return pictures


class InMemory:
    """Footage of arrays; see pipeline.footage.Footage."""

    repeated = 0

    def __init__(self, pictures: np.ndarray, name: str) -> None:
        self._pictures, self.source = pictures, source_of(name, np.arange(len(pictures)))
        self.skew_s = np.zeros(len(pictures), np.float32)

    def pictures(self):
        return iter(self._pictures)


@pytest.fixture
def workload(tmp_path, monkeypatch):
    """Writes a workload with ours and with lerobot; gives both folders and both times, lerobot's import left out."""
    for name in ("HF_HOME", "HF_DATASETS_CACHE", "HF_LEROBOT_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    import av  # noqa: F401  loaded for both before the clock starts
    logging.disable(logging.WARNING)  # lerobot tells at length where torchcodec finds no FFmpeg
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    def write(episodes, cameras, height, width):
        films = {(e.id, c): filmed(e, c, height, width) for e in episodes for c in cameras}
        tables = {e.id: FeatureTable(STATE, {n: np.random.default_rng(k).standard_normal(
            (e.frames, len(v))).astype(np.float32) for n, v in STATE.items()}) for k, e in enumerate(episodes)}
        recipe = Recipe(name="bench", dataset=DatasetConfig(held_out=0, cameras=dict.fromkeys(cameras, CameraConfig())))
        start = cpu()
        version = build(episodes, tables, recipe, store=tmp_path / "store", task="pick", generation=0, features=STATE,
                        footage=lambda e, c: InMemory(films[e.id, c], f"{e.blob} {c}"))
        ours = cpu() - start
        features = {n: {"dtype": "float32", "shape": (len(v),), "names": list(v)} for n, v in STATE.items()} | {
            f"observation.images.{c}": {"dtype": "video", "shape": (height, width, 3),
                                        "names": ["height", "width", "channels"]} for c in cameras}
        start = cpu()
        data = LeRobotDataset.create("hardcase/bench", fps=20, root=tmp_path / "lerobot", features=features,
                                     robot_type="arm")
        for e in episodes:
            columns = tables[e.id].columns()
            for k in range(e.frames):
                row = {n: v[k] for n, v in columns.items()}
                pictures = {f"observation.images.{c}": films[e.id, c][k] for c in cameras}
                data.add_frame({**row, **pictures, "task": "pick"})
            data.save_episode()
        data.finalize()
        return tmp_path / "store" / version.path, tmp_path / "lerobot", ours, cpu() - start

    return write


def size_mb(folder: Path) -> float:
    return sum(p.stat().st_size for p in folder.rglob("*.mp4")) / 1e6


@pytest.mark.parametrize(("cameras", "height", "width", "episodes", "frames", "least"), [
    (("front", "top"), 128, 128, 20 if FULL else 10, 100, 5),
    (("front",), 480, 640, 6 if FULL else 2, 100, 4),
], ids=["2 cameras 128x128", "1 camera 480x640"])
def test_write_videos_beside_lerobot(workload, cameras, height, width, episodes, frames, least):
    """Ours: a video an episode, exact statistics of every pixel, fsync. lerobot's default: PNG files, then a video."""
    folder, other, ours, theirs = workload(made(episodes, frames), cameras, height, width)
    print(f"\n{len(cameras)} x {height}x{width}, {episodes * frames} frames: ours {ours:.2f} CPU s "
          f"{size_mb(folder):.2f} MB, lerobot {theirs:.2f} CPU s {size_mb(other):.2f} MB, {theirs / ours:.1f} times")
    assert theirs / ours > least


def test_read_samples_beside_lerobot(workload):
    """Shuffled samples with 2 cameras 128x128 and a 16-step action chunk, in batches of 32; and without cameras."""
    folder, _, _, _ = workload(made(5, 100), ("front", "top"), 128, 128)
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from torch.utils.data import default_collate

    start = cpu()
    data = Samples.load(folder)
    once = cpu() - start
    deltas, rng = {"action": range(CHUNK)}, np.random.default_rng(0)

    def per_sample(source: Samples, batches: int, pictures: str = "float") -> float:
        source.sample(rng, 32, deltas)
        start = cpu()
        for _ in range(batches):
            source.sample(rng, 32, deltas, None, pictures)
        return (cpu() - start) / (32 * batches)

    ours, small = per_sample(data, 60), per_sample(data, 60, "bytes")
    state = per_sample(Samples.load(folder, cameras=()), 3000)
    steps = {"action": [k / 20 for k in range(CHUNK)]}
    theirs_data = LeRobotDataset("hardcase/bench", root=folder, delta_timestamps=steps)
    rows = rng.integers(0, len(theirs_data), 64)
    default_collate([theirs_data[int(k)] for k in rows[:2]])
    start = cpu()
    default_collate([theirs_data[int(k)] for k in rows])
    theirs = (cpu() - start) / len(rows)
    print(f"\n2 cameras: ours {1e3 * ours:.4f} CPU ms a sample ({1e3 * small:.4f} as bytes), decoding once "
          f"{1e3 * once / 1000:.3f} ms a picture; lerobot ({theirs_data.reader._video_backend}) {1e3 * theirs:.2f} ms, "
          f"{theirs / ours:.0f} times; our samples without cameras {1e6 * state:.2f} us")
    assert theirs / ours > 40


def test_read_state_samples_beside_lerobot(tmp_path, monkeypatch):
    """Shuffled samples of state with a 16-step action chunk, in batches of 256."""
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hf"))
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "hf/d"))
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from torch.utils.data import default_collate

    episodes = made(20, 100)
    tables = {e.id: FeatureTable(STATE, {n: np.random.default_rng(k).standard_normal(
        (e.frames, len(v))).astype(np.float32) for n, v in STATE.items()}) for k, e in enumerate(episodes)}
    version = build(episodes, tables, Recipe(name="bench"), store=tmp_path, task="pick", generation=0, features=STATE)
    data, deltas, rng = Samples.load(tmp_path / version.path), {"action": range(CHUNK)}, np.random.default_rng(0)
    start = cpu()
    for _ in range(1000):
        data.sample(rng, 256, deltas)
    ours = (cpu() - start) / 256_000
    theirs_data = LeRobotDataset("hardcase/bench", root=tmp_path / version.path,
                                 delta_timestamps={"action": [k / 20 for k in range(CHUNK)]})
    rows = rng.integers(0, len(theirs_data), 1000)
    theirs_data[0]
    start = cpu()
    default_collate([theirs_data[int(k)] for k in rows])
    theirs = (cpu() - start) / len(rows)
    print(f"\nstate only: ours {1e6 * ours:.2f} CPU us a sample, lerobot {1e3 * theirs:.2f} ms, "
          f"{theirs / ours:.0f} times")
    assert theirs / ours > 1000
