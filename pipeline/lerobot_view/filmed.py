"""The cameras of a version: one video an episode and camera, and what the tables say of them."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from pipeline.arrow import lists, pa, read_parquet, scalars, texts, to_arrow, to_rows
from pipeline.errors import DatasetError
from pipeline.footage import FEATURE, SKEW, Footage, FootageOf
from pipeline.frames import Features, FeatureTable, Table
from pipeline.lerobot_view import layout, pixels
from pipeline.lerobot_view.clips import Clip, Clips
from pipeline.lerobot_view.exact import MEASURES
from pipeline.lerobot_view.tables import Row
from schemas.episode import Episode
from schemas.recipe import CameraConfig

type ByCamera = Mapping[str, Sequence[Clip]]
"""Camera -> the clip of each episode, in the order of the version."""


NO_CLIPS: ByCamera = MappingProxyType({})


class ClipSource(Protocol):
    """Gives a version its clips."""

    def clips(self, rows: Sequence[Row], kept: int, part: Path) -> ByCamera:
        """The clips of all rows, of which the parent version holds the first `kept` unchanged."""
        ...


@dataclass(frozen=True, slots=True)
class Filmed:
    """Clips of footage, encoded where no version has them yet; see ClipSource."""

    wanted: Mapping[str, CameraConfig]
    footage: FootageOf
    store: Path
    fps: int
    parent: Path | None = None
    """Folder of a version with clips of the same cameras."""

    def clips(self, rows: Sequence[Row], kept: int, part: Path) -> ByCamera:
        """See ClipSource.

        Raises:
            HardcaseError: an episode has no footage, too few frames of it, or pictures that cannot be used.
        """
        before = clips_in(self.parent) if self.parent is not None else {}
        videos = Clips(self.store, {clip.key: clip for clip in before.values()})
        found: dict[str, list[Clip]] = {}
        for camera, config in self.wanted.items():
            found[camera] = [before[row.episode.id, camera] for row in rows[:kept]]
            for row in rows[kept:]:
                where = f"episode {row.episode.id}, camera {camera}"
                clip = videos.clip(self.footage(row.episode, camera), config, fps=self.fps, part=part, where=where)
                if clip.frames != row.episode.frames:
                    raise DatasetError(f"{clip.frames} pictures for {row.episode.frames} frames", where=where,
                                       mend="leave the episode out, or record it again")
                found[camera].append(clip)
        return found


def once(footage: FootageOf) -> FootageOf:
    """The same, but each episode and camera is asked for once: looking a recording through takes time."""
    taken: dict[tuple[str, str], Footage] = {}

    def get(episode: Episode, camera: str) -> Footage:
        if (key := (episode.id, camera)) not in taken:
            taken[key] = footage(episode, camera)
        return taken[key]

    return get


def skews(features: Features, cameras: Iterable[str]) -> Features:
    """Features with a column skew.camera.CAMERA for each camera that has none yet."""
    return {**features, **{SKEW + name: (name,) for name in cameras if SKEW + name not in features}}


def with_skews(frames_of: Callable[[Episode], Table], cameras: Collection[str],
               footage: FootageOf) -> Callable[[Episode], Table]:
    """Frames with the skews of their pictures, where they do not have them already.

    Raises:
        DatasetError: the footage is not as long as the episode.
    """
    def get(episode: Episode) -> Table:
        table = frames_of(episode)
        columns = table.columns()
        for name in (name for name in cameras if SKEW + name not in columns):
            columns[SKEW + name] = footage(episode, name).skew_s[:, None]
            if len(columns[SKEW + name]) != len(table):
                raise DatasetError(f"{len(columns[SKEW + name])} pictures for {len(table)} frames",
                                   where=f"episode {episode.id}, camera {name}", mend="leave the episode out")
        return FeatureTable(skews(table.names, cameras), columns)

    return get


def sizes(clips: ByCamera, rows: Sequence[Row]) -> dict[str, tuple[int, int]]:
    """Camera -> height and width, which all of its clips share.

    Raises:
        DatasetError: they do not; names the first episode that differs.
    """
    found: dict[str, tuple[int, int]] = {}
    for camera, many in clips.items():
        for row, clip in zip(rows, many, strict=True):
            height, width = found.setdefault(camera, (clip.height, clip.width))
            if (clip.height, clip.width) != (height, width):
                raise DatasetError(f"camera {camera!r} has {clip.width}x{clip.height}, the episodes before it "
                                   f"{width}x{height}", where=f"episode {row.episode.id}",
                                   mend=f"give it a width and height in the recipe: dataset.cameras.{camera}")
    return found


def statistics(clips: ByCamera, frames: int) -> dict[str, dict[str, object]]:
    """Feature -> measures over every pixel of the version, as stats.json holds them."""
    return {FEATURE + camera: pixels.for_stats(pixels.measure(np.sum([c.histogram for c in many], axis=0)), frames)
            for camera, many in clips.items()}


def episode_columns(clips: ByCamera, fps: int) -> dict[str, Any]:
    """Columns of the episodes table: where each video lies, its statistics, and how many frames repeat a picture."""
    columns: dict[str, Any] = {}
    for camera, many in clips.items():
        name, places = FEATURE + camera, [layout.chunk_and_file(k) for k in range(len(many))]
        columns |= {
            f"videos/{name}/chunk_index": scalars(np.array([chunk for chunk, _ in places])),
            f"videos/{name}/file_index": scalars(np.array([file for _, file in places])),
            f"videos/{name}/from_timestamp": scalars(np.array([c.first / fps for c in many])),
            f"videos/{name}/to_timestamp": scalars(np.array([(c.first + c.frames) / fps for c in many])),
        }
        measures = np.stack([pixels.measure(c.histogram) for c in many])
        for k, measure in enumerate(MEASURES):
            nested = lists(lists(scalars(measures[:, k].reshape(-1)), 1), 1)
            columns[f"stats/{name}/{measure}"] = lists(nested, 3)
        columns[f"stats/{name}/count"] = lists(scalars(np.array([c.frames for c in many])), 1)
        columns[f"repeated.{camera}"] = scalars(np.array([c.repeated for c in many]))
    return columns


def write_clips(path: Path, clips: ByCamera, ids: Sequence[str]) -> None:
    """meta/pictures.parquet: a row an episode and camera, the episodes of a camera in their order."""
    flat = [(id, camera, clip) for camera, many in clips.items() for id, clip in zip(ids, many, strict=True)]
    numbers = {name: scalars(np.array([getattr(clip, name) for *_, clip in flat]))
               for name in ("height", "width", "frames", "first", "repeated")}
    table = pa.table({
        "episode_id": texts([episode for episode, *_ in flat]), "camera": texts([camera for _, camera, _ in flat]),
        "sha256": texts([c.sha256 for *_, c in flat]), "key": texts([c.key for *_, c in flat]),
        "source": texts([c.source for *_, c in flat]), **numbers,
        "histogram": to_arrow(np.stack([c.histogram.reshape(-1) for *_, c in flat])),
    })
    pa.parquet.write_table(table, path)


def clips_in(folder: Path) -> dict[tuple[str, str], Clip]:
    """Episode id and camera -> clip, of a version that lies in a folder; empty for one without cameras."""
    if not (folder / layout.PICTURES).is_file():
        return {}
    table = read_parquet(folder / layout.PICTURES)
    histograms = to_rows(table.column("histogram"), 3 * 256).reshape(-1, 3, 256)
    names = ("episode_id", "camera", "sha256", "key", "source", "height", "width", "frames", "first", "repeated")
    number: dict[str, int] = {}
    found: dict[tuple[str, str], Clip] = {}
    for k, row in enumerate(zip(*(table.column(name).to_pylist() for name in names), strict=True)):
        episode, camera, sha, key, source, height, width, frames, first, repeated = row
        place = number[camera] = number.get(camera, -1) + 1
        found[episode, camera] = Clip(folder / layout.video_file(camera, place), sha, key, source, height, width,
                                      frames, histograms[k], first, repeated)
    return found
