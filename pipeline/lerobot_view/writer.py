"""Writes a version folder from frames."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from pipeline.errors import DatasetError
from pipeline.frames import FEATURES, Features, Table
from pipeline.lerobot_view import filmed, layout
from pipeline.lerobot_view.agreement import refuse_others
from pipeline.lerobot_view.exact import as_matrix, by_feature, measure
from pipeline.lerobot_view.filmed import NO_CLIPS, ClipSource
from pipeline.lerobot_view.sealing import building, link, seal, write_json, write_manifest
from pipeline.lerobot_view.sharing import shared_with
from pipeline.lerobot_view.tables import Columns, Place, Row, frame_columns, write_episodes, write_frames, write_tasks
from pipeline.shards import check_frames
from schemas.episode import Episode

type FramesOf = Callable[[Episode], Table]

PART = "video.part"
"""A video that is being encoded, in the folder that is being built."""


def write_version(target: Path, rows: Sequence[Row], frames_of: FramesOf, manifest: Mapping[str, object], *,
                  aside: Path, fps: int, robot: str, parent: Path | None = None, of: Features = FEATURES,
                  films: ClipSource | None = None) -> None:
    """Write one LeRobot v3.0 folder that never changes again.

    Whoever looks at `target` sees nothing or all of it; see pipeline.lerobot_view.sealing.

    Args:
        target: the folder, which must not exist yet.
        aside: a folder for unfinished things, on the same file system.
        rows: the episodes in the order of episode_index, at least one.
        frames_of: gives the frames of an episode; asked once for each that the parent does not share.
        manifest: what meta/hardcase.json says besides the digests of the other files.
        fps: rate of the control clock [Hz].
        robot: name of the robot.
        parent: folder of a version whose data files may be shared; it has the same features.
        of: the features of the robot, which every episode must have.
        films: gives the videos of its cameras, if it has any.

    Raises:
        RecordingError, DatasetError: frames or pictures that cannot be trained on; the error names the episode.
        DatasetError: the disk is full or read-only; nothing is left behind.
    """
    with building(target, aside) as folder:
        videos = _fill(folder, rows, frames_of, of, fps=fps, robot=robot, parent=parent, films=films)
        write_manifest(folder, manifest, videos)
        seal(folder, videos)


def _fill(folder: Path, rows: Sequence[Row], frames_of: FramesOf, of: Features, *, fps: int, robot: str,
          parent: Path | None, films: ClipSource | None) -> dict[str, str]:
    """Write everything but the manifest; returns the digests of the videos, which were on the disk before."""
    shared = shared_with(parent, rows, of)
    if parent is not None:
        for file in shared.files:
            link(parent / file, folder / file)
    tasks = list(dict.fromkeys(row.task for row in rows))
    places, columns, measures = list(shared.places), shared.columns, [shared.measures]
    new = rows[len(places):]
    if new:
        frames = [_checked(frames_of(row.episode), row.episode, of) for row in new]
        fresh = frame_columns(new, frames, tasks, fps=fps, first_episode=len(places),
                              first_frame=places[-1].stop if places else 0)
        added = _write_files(folder, fresh, [len(f) for f in frames], places, layout.frame_bytes(of))
        matrix, first = as_matrix(fresh), added[0].start
        measures.append(np.stack([measure(matrix[:, p.start - first:p.stop - first]) for p in added]))
        columns = {name: np.concatenate([columns[name], fresh[name]]) if places else fresh[name] for name in fresh}
        places += added
    total = places[-1].stop
    clips = films.clips(rows, len(shared.places), folder / PART) if films is not None else NO_CLIPS
    size = filmed.sizes(clips, rows)
    write_tasks(folder / layout.TASKS, tasks)
    write_episodes(folder / layout.EPISODES, rows, places, np.concatenate(measures), of,
                   filmed.episode_columns(clips, fps))
    write_json(folder / layout.STATS, {**by_feature(measure(as_matrix(columns)), total, of),
                                       **filmed.statistics(clips, total)})
    write_json(folder / layout.INFO, layout.info(robot=robot, fps=fps, episodes=len(rows), frames=total,
                                                 tasks=len(tasks), of=of, cameras=size))
    return link_videos(folder, clips, [row.episode.id for row in rows])


def link_videos(folder: Path, clips: filmed.ByCamera, ids: Sequence[str]) -> dict[str, str]:
    """Give every clip its place in a version, and write down what each was made from; returns their digests."""
    videos: dict[str, str] = {}
    for camera, many in clips.items():
        for number, clip in enumerate(many):
            name = layout.video_file(camera, number)
            link(clip.file, folder / name)
            videos[name] = clip.sha256
    if clips:
        filmed.write_clips(folder / layout.PICTURES, clips, ids)
    return videos


def _write_files(folder: Path, columns: Columns, lengths: Sequence[int], before: Sequence[Place],
                 frame_bytes: int) -> list[Place]:
    """Write new data files of at most DATA_FILE_MB; a parent's file is never added to."""
    limit = layout.DATA_FILE_MB * 2**20 // frame_bytes
    file, start = (before[-1].file + 1, before[-1].stop) if before else (0, 0)
    origin, places, groups = start, list[Place](), list[list[int]]([[]])
    for length in lengths:
        if groups[-1] and sum(groups[-1]) + length > limit:
            groups.append([])
        groups[-1].append(length)
        places.append(Place(file + len(groups) - 1, start, start + length))
        start += length
    for number, group in enumerate(groups):
        head = next(p.start for p in places if p.file == file + number) - origin
        part = {name: values[head:head + sum(group)] for name, values in columns.items()}
        write_frames(folder / layout.data_file(file + number), part, group)
    return places


def _checked(frames: Table, episode: Episode, of: Features) -> Table:
    refuse_others(frames.names, of, robot=episode.scene.robot, where=f"episode {episode.id}")
    check_frames(frames, f"episode {episode.id}")
    if len(frames) != episode.frames:
        raise DatasetError(f"{len(frames)} frames were read, the episode has {episode.frames}",
                           where=f"episode {episode.id}", mend="recover the recording or drop the episode")
    return frames
