"""Writes the folder of a derived version: what did not change is shared, what did is written anew."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.errors import DatasetError
from pipeline.files import sha256
from pipeline.footage import FEATURE
from pipeline.lerobot_view import filmed, layout, pixels, video
from pipeline.lerobot_view.clips import Clip
from pipeline.lerobot_view.derived_table import write_derived_episodes
from pipeline.lerobot_view.exact import by_width, measure
from pipeline.lerobot_view.filmed import ByCamera, clips_in
from pipeline.lerobot_view.moved import as_matrix, measured, moved, whole_matrix, write_moved
from pipeline.lerobot_view.plan import Plan
from pipeline.lerobot_view.sealing import building, link, seal, write_json, write_manifest
from pipeline.lerobot_view.tables import write_tasks
from pipeline.lerobot_view.writer import link_videos

type Last = Callable[[Path, Mapping[str, str]], None]


def write_derived(target: Path, plan: Plan, content: Mapping[str, object], *, aside: Path,
                  clips: ByCamera, last: Last | None = None) -> dict[str, str]:
    """Write the folder of a planned version; see pipeline.lerobot_view.sealing for how it comes into being.

    Args:
        target: the folder, which must not exist yet.
        plan: what it holds.
        content: what the manifest says besides the digests of files.
        aside: a folder for unfinished things, on the same file system.
        clips: the videos, from `clips_of`.
        last: writes more files once all others but the manifest are there; given the folder and known digests.

    Returns:
        The digest of every file.

    Raises:
        DatasetError: a file of a source is missing or was changed, or the disk is full or read-only.
    """
    with building(target, aside) as folder:
        shared = _fill(folder, plan, clips)
        if last is not None:
            last(folder, shared)
        hashes = write_manifest(folder, content, shared)
        seal(folder, shared)
    return hashes


def clips_of(plan: Plan) -> dict[str, list[Clip]]:
    """The videos of a planned version, none encoded again; of a trimmed episode another part is addressed.

    Raises:
        DatasetError: a video is missing, or one that is trimmed cannot be read.
    """
    draft = plan.draft
    known = [clips_in(source.folder) for source in draft.sources] if draft.parent.cameras else []
    cut = set(plan.trimmed.tolist())
    found: dict[str, list[Clip]] = {camera.removeprefix(FEATURE): [] for camera in draft.parent.cameras}
    for camera, clips in found.items():
        for k, (id, (source, s, _, start)) in enumerate(zip(plan.ids, draft.walk(), strict=True)):
            clip = known[s][id, camera]
            if not clip.file.is_file():
                raise DatasetError(f"the video of camera {camera!r} is missing", where=f"episode {id}",
                                   mend=f"build version {source.version.id} again, or drop the episode")
            clips.append(_cut(clip, start, int(draft.stop[k])) if k in cut else clip)
    return found


def _cut(clip: Clip, start: int, stop: int) -> Clip:
    """The same file, another part. Its pixels are counted as they are decoded: the originals are not at hand."""
    first, until = clip.first + start, clip.first + stop
    wanted = (picture for n, picture in enumerate(video.decoded(clip.file)) if first <= n < until)
    counts = pixels.empty()
    for _ in pixels.counted(wanted, counts):
        pass
    return replace(clip, key=sha256(f"{clip.key} {first} {until}".encode()), first=first, frames=stop - start,
                   histogram=counts)


def _fill(folder: Path, plan: Plan, clips: ByCamera) -> dict[str, str]:
    """Write everything but the manifest; returns the digests of the files that are shared."""
    parent = plan.draft.parent
    shared = _share_head(folder, plan)
    table = moved(plan)
    numbers = write_moved(folder, plan, table)
    rows = as_matrix(table, parent.widths) if table is not None else None
    write_tasks(folder / layout.TASKS, plan.tasks)
    measures = measured(plan, rows) if rows is not None else np.empty((0, 0, 0))
    write_derived_episodes(folder / layout.EPISODES, plan, numbers, measures, clips)
    write_json(folder / layout.INFO, {**parent.info, "total_episodes": len(plan.ids), "total_frames": plan.frames,
                                      "total_tasks": len(plan.tasks), "splits": {"train": f"0:{len(plan.ids)}"}})
    if plan.same_frames:
        link(parent.folder / layout.STATS, folder / layout.STATS)
        shared[layout.STATS] = parent.hashes[layout.STATS]
    else:
        numeric = by_width(measure(whole_matrix(plan, rows)), plan.frames, parent.widths)
        write_json(folder / layout.STATS, {**numeric, **filmed.statistics(clips, plan.frames)})
    return shared | link_videos(folder, clips, plan.ids)


def _share_head(folder: Path, plan: Plan) -> dict[str, str]:
    """Share the data files that did not change."""
    parent = plan.draft.parent
    names = [layout.data_file(n) for n in np.unique(parent.files[:plan.head]).tolist()]
    for name in names:
        if not (parent.folder / name).is_file():
            parent.vouch(name)  # which says so
        link(parent.folder / name, folder / name)
    return {name: parent.hashes[name] for name in names}
