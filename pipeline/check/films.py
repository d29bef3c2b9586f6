"""Pictures of a LeRobot dataset: videos by their packets, then decoded once a file; images out of the data files."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import read_parquet
from pipeline.check.pictures import Grey, compressed, small
from pipeline.check.signals import THUMB, Camera, Tables
from pipeline.errors import DatasetError

MEND = "name the folder of a LeRobot v3.0 dataset, the one that holds meta/info.json"


def pictures_there(folder: Path, info: Mapping[str, Any],
                   episodes: Mapping[str, list[Any]]) -> dict[tuple[str, int], int]:
    """(video feature, episode) -> pictures that the video holds for it, by its own packets."""
    found: dict[tuple[str, int], int] = {}
    fps = float(info["fps"])
    for name in _videos(info):
        stamps: dict[Path, NDArray[np.float64]] = {}
        for k, (path, start, stop) in enumerate(_places(folder, info, episodes, name)):
            if path not in stamps:
                stamps[path] = _packet_stamps(path)
            inside = (stamps[path] >= start - 0.5 / fps) & (stamps[path] < stop - 0.5 / fps)
            found[name, int(episodes["episode_index"][k])] = int(inside.sum())
    return found


def _videos(info: Mapping[str, Any]) -> list[str]:
    return [n for n, f in info["features"].items() if f["dtype"] == "video"]


def _places(folder: Path, info: Mapping[str, Any], episodes: Mapping[str, list[Any]],
            name: str) -> Iterator[tuple[Path, float, float]]:
    """File, first and last moment of every episode's video."""
    columns = [episodes[f"videos/{name}/{part}"]
               for part in ("chunk_index", "file_index", "from_timestamp", "to_timestamp")]
    for chunk, file, start, stop in zip(*columns, strict=True):
        relative = str(info["video_path"]).format(video_key=name, chunk_index=chunk, file_index=file)
        path = (folder / relative).resolve()
        if folder.resolve() not in path.parents:
            raise DatasetError(f"video path {relative!r} leads out of the dataset", where=folder, mend=MEND)
        yield path, float(start), float(stop)


def _packet_stamps(path: Path) -> NDArray[np.float64]:
    """Presentation times of all packets [s]; nothing is decoded."""
    import av
    from av.error import FFmpegError

    stamps: list[float] = []
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            base = float(stream.time_base or 1)
            stamps += [float(p.pts) * base for p in container.demux(stream) if p.pts is not None]
    except (FFmpegError, IndexError) as error:
        raise DatasetError(f"video cannot be read: {error}", where=path, mend="encode it again from its recordings") \
            from error
    return np.sort(np.array(stamps))


def film_cameras(folder: Path, tables: Tables) -> dict[int, dict[str, Camera]]:
    """Place of an episode -> its cameras: videos decoded once a file, pictures out of the data files."""
    found: dict[int, dict[str, Camera]] = {}
    for name in _videos(tables.info):
        files: dict[Path, Film] = {}
        for k, (path, start, stop) in enumerate(_places(folder, tables.info, tables.episodes, name)):
            if path not in files:
                files = {path: _decoded(path)}
            found.setdefault(k, {})[name] = files[path].camera(name, start, stop, 0.5 / float(tables.info["fps"]))
    for name in (n for n, f in tables.info["features"].items() if f["dtype"] == "image"):
        for k, camera in _images(folder, tables, name):
            found.setdefault(k, {})[name] = camera
    return found


@dataclass(frozen=True, slots=True)
class Film:
    """The pictures of one video file."""

    stamps_s: NDArray[np.float64]
    thumbs: list[Grey]
    prints: list[bytes]
    size: tuple[int, int]

    def camera(self, name: str, start_s: float, stop_s: float, half_s: float) -> Camera:
        """The pictures of one episode: those from `start_s` to before `stop_s`, half a frame earlier each."""
        inside = np.flatnonzero((self.stamps_s >= start_s - half_s) & (self.stamps_s < stop_s - half_s))
        stamps = np.round((self.stamps_s[inside] - start_s) * 1e9).astype(np.int64)
        thumbs = np.array([self.thumbs[int(i)] for i in inside], np.uint8).reshape(-1, THUMB[1], THUMB[0])
        return Camera(name, stamps, thumbs, tuple(self.prints[int(i)] for i in inside), self.size, video=True)


def _decoded(path: Path) -> Film:
    import av

    film = Film(np.empty(0), [], [], (0, 0))
    stamps: list[float] = []
    size = (0, 0)
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            grey = np.ascontiguousarray(frame.to_ndarray(format="gray"))
            size = (frame.width, frame.height)
            stamps.append(float(frame.time or 0.0))
            film.thumbs.append(small(grey))
            film.prints.append(blake2b(grey, digest_size=8).digest())
    return Film(np.array(stamps), film.thumbs, film.prints, size)


def _images(folder: Path, tables: Tables, name: str) -> Iterator[tuple[int, Camera]]:
    """Cameras of an image feature, whose files lie in the data files as {bytes, path}."""
    cells: list[Any] = []
    for path in sorted((folder / "data").rglob("*.parquet")):
        cells += read_parquet(path, [name]).column(name).to_pylist()
    stop = 0
    for k, length in enumerate(tables.episodes["length"]):
        start, stop = stop, stop + int(length)
        pictures = [compressed(memoryview(c["bytes"])) if c and c.get("bytes") else None for c in cells[start:stop]]
        there = [i for i, p in enumerate(pictures) if p is not None]
        whole = [p for p in pictures if p is not None]
        if whole:
            stamps = np.round(np.array(there) / float(tables.info["fps"]) * 1e9).astype(np.int64)
            prints = tuple(blake2b(cells[start + i]["bytes"], digest_size=8).digest() for i in there)
            yield k, Camera(name, stamps, np.stack([p[0] for p in whole]), prints, whole[0][1])
