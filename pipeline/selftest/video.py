"""Datasets with cameras: one video an episode and camera, as lerobot lays them; made, and spoiled."""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, read_parquet, scalars
from pipeline.lerobot_view.layout import EPISODES, INFO, MANIFEST
from pipeline.selftest.filming import CAMERAS

type Rng = np.random.Generator
type Frames = NDArray[np.uint8]
"""RGB, shape (n, height, width, 3)."""

FEATURES = tuple(f"observation.images.{name}" for name in CAMERAS)
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
CODEC = "libx264"
LAG = 8
"""Frames; 0.4 s at 20 Hz."""


def add_videos(clean: Path, folder: Path, pictures: Sequence[Mapping[str, Frames]]) -> None:
    """A copy of a version as a dataset of somebody who has cameras; our manifest, which knows none, is left out.

    Args:
        clean: the version.
        folder: where the copy is written.
        pictures: camera -> pictures, for every episode in order.
    """
    shutil.copytree(clean, folder, copy_function=shutil.copyfile)
    (folder / MANIFEST).unlink()
    info = json.loads((folder / INFO).read_text())
    fps, table = int(info["fps"]), read_parquet(folder / EPISODES)
    info["video_path"] = VIDEO_PATH
    for camera, feature in zip(CAMERAS, FEATURES, strict=True):
        height, width = pictures[0][camera].shape[1:3]
        info["features"][feature] = {"dtype": "video", "shape": [height, width, 3],
                                     "names": ["height", "width", "channels"]}
        lengths = [len(p[camera]) for p in pictures]
        columns = {"chunk_index": [0] * len(lengths), "file_index": [*range(len(lengths))],
                   "from_timestamp": [0.0] * len(lengths), "to_timestamp": [n / fps for n in lengths]}
        for name, values in columns.items():
            table = table.append_column(f"videos/{feature}/{name}", scalars(np.array(values)))
        for k, seen in enumerate(pictures):
            encode(video_of(folder, feature, k), seen[camera], fps)
    (folder / INFO).write_text(json.dumps(info, indent=1) + "\n")
    pa.parquet.write_table(table, folder / EPISODES)


def video_of(folder: Path, feature: str, episode: int) -> Path:
    """The video of one episode and camera."""
    return folder / VIDEO_PATH.format(video_key=feature, chunk_index=0, file_index=episode)


def encode(path: Path, frames: Frames, fps: int) -> None:
    """Write a video of constant rate, without pictures that depend on later ones."""
    av: Any = import_module("av")  # its streams are typed by codec, which pyright strict does not follow
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(CODEC, rate=fps, options={"bf": "0", "crf": "23", "threads": "1"})
        stream.height, stream.width, stream.pix_fmt = frames.shape[1], frames.shape[2], "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def decode(path: Path) -> Frames:
    """All pictures of a video."""
    av: Any = import_module("av")
    container = av.open(str(path))
    try:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])
    finally:
        container.close()


def spoiled(change: Callable[[Frames, Rng], Frames]) -> Callable[[Path, Path, Rng], None]:
    """A planter: the video of one camera in one episode is encoded anew, changed."""
    def plant(clean: Path, folder: Path, rng: Rng) -> None:
        shutil.copytree(clean, folder, copy_function=shutil.copyfile)
        path = _any_video(folder, rng)
        encode(path, change(decode(path), rng), _fps(folder))
    return plant


def swapped(clean: Path, folder: Path, rng: Rng) -> None:
    """In one episode the two cameras are exchanged."""
    shutil.copytree(clean, folder, copy_function=shutil.copyfile)
    one, other = (video_of(folder, feature, int(k)) for feature, k in
                  zip(FEATURES, [rng.integers(_episodes(folder))] * 2, strict=True))
    aside = one.rename(one.with_suffix(".aside"))
    other.rename(one)
    aside.rename(other)


def swapped_on_the_way(clean: Path, folder: Path, rng: Rng) -> None:
    """In one episode the two cameras change places in the middle."""
    shutil.copytree(clean, folder, copy_function=shutil.copyfile)
    episode = int(rng.integers(_episodes(folder)))
    files = [video_of(folder, feature, episode) for feature in FEATURES]
    one, other = (decode(file) for file in files)
    half = len(one) // 2
    encode(files[0], np.concatenate([one[:half], other[half:]]), _fps(folder))
    encode(files[1], np.concatenate([other[:half], one[half:]]), _fps(folder))


def gone(clean: Path, folder: Path, rng: Rng) -> None:
    """One video was not copied."""
    shutil.copytree(clean, folder, copy_function=shutil.copyfile)
    _any_video(folder, rng).unlink()


def cut(clean: Path, folder: Path, rng: Rng) -> None:
    """One video ends after 60 to 90 % of its bytes: a copy that broke off."""
    shutil.copytree(clean, folder, copy_function=shutil.copyfile)
    path = _any_video(folder, rng)
    data = path.read_bytes()
    path.write_bytes(data[:int(rng.uniform(0.6, 0.9) * len(data))])


def _any_video(folder: Path, rng: Rng) -> Path:
    return video_of(folder, str(rng.choice(FEATURES)), int(rng.integers(_episodes(folder))))


def dropped(frames: Frames, rng: Rng) -> Frames:
    """The encoder's queue was full: three pictures are missing."""
    return np.delete(frames, rng.integers(len(frames) - 3) + np.arange(3), axis=0)


def black(frames: Frames, rng: Rng) -> Frames:
    """The camera is black for 10 pictures."""
    dark, start = frames.copy(), int(rng.integers(len(frames) - 10))
    dark[start:start + 10] = 3
    return dark


def late(frames: Frames, rng: Rng) -> Frames:
    """Every row shows the picture of 8 rows before."""
    return np.concatenate([np.repeat(frames[:1], LAG, axis=0), frames[:-LAG]])


def early(frames: Frames, rng: Rng) -> Frames:
    """Every row shows the picture of 8 rows later."""
    return np.concatenate([frames[LAG:], np.repeat(frames[-1:], LAG, axis=0)])


def frozen(frames: Frames, rng: Rng) -> Frames:
    """The same picture for 1 s, while the arm moves."""
    still, start = frames.copy(), int(rng.integers(3, max(4, len(frames) // 2 - 10)))
    still[start:start + 21] = frames[start]
    return still


def ends_early(frames: Frames, rng: Rng) -> Frames:
    """The camera died when 60 to 80 % of the attempt were over."""
    return frames[:int(rng.uniform(0.6, 0.8) * len(frames))]


def _episodes(folder: Path) -> int:
    return int(json.loads((folder / INFO).read_text())["total_episodes"])


def _fps(folder: Path) -> int:
    return int(json.loads((folder / INFO).read_text())["fps"])
