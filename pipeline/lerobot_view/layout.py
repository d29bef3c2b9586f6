"""The layout of a LeRobot v3.0 folder: names of files, features in column order, info.json.

Source: lerobot 0.6.1, lerobot/datasets/utils.py (DatasetInfo, path patterns) and dataset_metadata.py.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from pipeline.footage import FEATURE
from pipeline.frames import FEATURES, Features
from pipeline.lerobot_view import video

INFO = "meta/info.json"
STATS = "meta/stats.json"
TASKS = "meta/tasks.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
MANIFEST = "meta/hardcase.json"
"""Ours: lerobot logs a warning about every key of info.json that it does not know."""

PICTURES = "meta/pictures.parquet"
"""Ours: what each video was made from, and the pixel counts that exact statistics are added up from."""

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
FILES_PER_CHUNK = 1000
DATA_FILE_MB = 100

type Sizes = Mapping[str, tuple[int, int]]
"""Camera -> height and width of its pictures [px]."""
NO_CAMERAS: Sizes = MappingProxyType({})

INTERVENTION = "intervention"
"""Whether a person or their stand-in commanded the frame after a policy had begun the episode."""

BOOKKEEPING = {
    "timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64", "task_index": "int64",
}
"""Columns that every LeRobot dataset has, one value a frame."""


def features(of: Features = FEATURES, cameras: Sizes = NO_CAMERAS, fps: int = 0) -> dict[str, dict[str, object]]:
    """Feature name -> dtype, shape and value names, in the column order of the data files; videos have no column."""
    declared: dict[str, dict[str, object]] = {
        name: {"dtype": "float32", "shape": [len(names)], "names": list(names)} for name, names in of.items()
    }
    for camera, (height, width) in cameras.items():
        declared[FEATURE + camera] = {"dtype": "video", "shape": [height, width, 3],
                                      "names": ["height", "width", "channels"], "info": video.about(height, width, fps)}
    declared[INTERVENTION] = {"dtype": "int64", "shape": [1], "names": None}
    declared |= {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in BOOKKEEPING.items()}
    return declared


def widths(of: Features = FEATURES) -> dict[str, int]:
    """Feature name -> values a frame, in column order."""
    return {name: len(names) for name, names in of.items()} | {
        name: 1 for name in (INTERVENTION, *BOOKKEEPING)
    }


def frame_bytes(of: Features = FEATURES) -> int:
    """Uncompressed size of one frame in a data file [B]."""
    return sum(len(names) for names in of.values()) * 4 + 8 + 4 + 4 * 8


def info(*, robot: str, fps: int, episodes: int, frames: int, tasks: int, of: Features = FEATURES,
         cameras: Sizes = NO_CAMERAS) -> dict[str, object]:
    """The content of info.json.

    The one split, train, spans every episode, because a LeRobot split must be a contiguous range and
    held-out lineages are not: which episodes are held out stands in the episodes table and the manifest.
    """
    return {
        "codebase_version": "v3.0",
        "fps": fps,
        "features": features(of, cameras, fps),
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": FILES_PER_CHUNK,
        "data_files_size_in_mb": DATA_FILE_MB,
        "video_files_size_in_mb": 200,
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH if cameras else None,
        "robot_type": robot,
        "splits": {"train": f"0:{episodes}"},
    }


def chunk_and_file(number: int) -> tuple[int, int]:
    """Chunk index and file index of data file 0, 1, 2, ... of a version."""
    return divmod(number, FILES_PER_CHUNK)


def file_number(chunk: int, file: int) -> int:
    """The inverse of chunk_and_file."""
    return chunk * FILES_PER_CHUNK + file


def data_file(number: int) -> str:
    """Relative path of data file 0, 1, 2, ... of a version."""
    chunk, file = chunk_and_file(number)
    return DATA_PATH.format(chunk_index=chunk, file_index=file)


def video_file(camera: str, number: int) -> str:
    """Relative path of the video of episode 0, 1, 2, ... of a version."""
    chunk, file = chunk_and_file(number)
    return VIDEO_PATH.format(video_key=FEATURE + camera, chunk_index=chunk, file_index=file)


def files_in(folder: Path) -> Iterable[Path]:
    """Every file below the folder, sorted by relative path."""
    return sorted((p for p in folder.rglob("*") if not p.is_dir()), key=Path.as_posix)  # all begin with the folder
