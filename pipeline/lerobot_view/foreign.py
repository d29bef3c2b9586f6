"""A LeRobot v3 folder of somebody else's, read for import: frames, tasks and videos of each episode."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, read_parquet, to_rows
from pipeline.errors import DatasetError, one_line
from pipeline.frames import Features
from pipeline.lerobot_view.layout import BOOKKEEPING, EPISODES, INFO, INTERVENTION, TASKS
from pipeline.lerobot_view.opened import read_tasks

MEND = "name the folder of a whole LeRobot v3.0 dataset; see what is wrong with it: hardcase check FOLDER"
KINDS = {"float32", "float64", "int64", "int32", "int16", "int8", "uint8", "uint16", "uint32", "bool"}
EXACT = 2**24
"""Whole numbers up to this are the same in float32."""


@dataclass(frozen=True)
class Span:
    """Where the pictures of one episode and camera are."""

    file: Path
    start_s: float
    stop_s: float


@dataclass(frozen=True)
class Foreign:
    """A foreign dataset; every array is read once."""

    folder: Path
    info: Mapping[str, Any]
    episodes: Mapping[str, list[Any]]
    """Columns of the episodes table, statistics left out."""
    tasks: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.episodes["length"])

    @property
    def fps(self) -> int:
        """Frames a second."""
        return int(self.info["fps"])

    @cached_property
    def features(self) -> Features:
        """Feature -> names of its values, in column order; numbers alone, what every dataset has left out."""
        found: dict[str, tuple[str, ...]] = {}
        for name, what in self.info["features"].items():
            if name in BOOKKEEPING or name == INTERVENTION or what["dtype"] == "video":
                continue
            shape = [int(n) for n in what["shape"]]
            if what["dtype"] not in KINDS or len(shape) != 1:
                raise DatasetError(f"feature {name} is {what['dtype']} of shape {shape}; numbers in one row are taken, "
                                   "and videos", where=self.folder,
                                   mend="with lerobot-edit-dataset: convert_image_to_video for images, remove_feature "
                                        "for what is no number")
            found[name] = _names(name, what.get("names"), shape[0])
        return found

    @property
    def cameras(self) -> dict[str, str]:
        """Video feature -> what the camera is called here: the last part of its name."""
        return {n: n.rpartition(".")[2] for n, f in self.info["features"].items() if f["dtype"] == "video"}

    @cached_property
    def _columns(self) -> dict[str, NDArray[Any]]:
        wanted = {**{n: len(v) for n, v in self.features.items()}, "index": 1, "episode_index": 1}
        if INTERVENTION in self.info["features"]:
            wanted[INTERVENTION] = 1
        parts: dict[str, list[NDArray[Any]]] = {name: [] for name in wanted}
        for path in sorted((self.folder / "data").rglob("*.parquet")):
            table = read_parquet(path)
            for name, width in wanted.items():
                column = table.column(name)
                while pa.types.is_nested(column.type) and pa.types.is_boolean(column.type.value_type):
                    column = column.cast(pa.list_(pa.uint8(), width))
                parts[name].append(to_rows(column.cast(pa.uint8()) if pa.types.is_boolean(column.type) else column,
                                           width))
        return {name: np.concatenate(arrays) for name, arrays in parts.items()}

    def frames(self, k: int) -> dict[str, NDArray[np.float32]]:
        """The features of an episode, shape (frames, values) each.

        Raises:
            DatasetError: a whole number that float32 does not hold.
        """
        found: dict[str, NDArray[np.float32]] = {}
        for name in self.features:
            rows = self._columns[name][self._rows(k)]
            if rows.dtype.kind in "iu" and rows.size and np.abs(rows.astype(np.int64)).max() > EXACT:
                raise DatasetError(f"feature {name} holds whole numbers beyond {EXACT}", where=f"episode {k}",
                                   mend="take the feature out: lerobot-edit-dataset, remove_feature")
            found[name] = np.ascontiguousarray(rows, np.float32)
        return found

    def taken_over(self, k: int) -> NDArray[np.bool_]:
        """Frames of an episode that its dataset marks as an intervention, shape (frames,)."""
        marks = self._columns.get(INTERVENTION)
        return np.zeros(int(self.episodes["length"][k]), np.bool_) if marks is None else marks[self._rows(k), 0] == 1

    def _rows(self, k: int) -> slice:
        edges = np.cumsum([0, *self.episodes["length"]])
        return slice(int(edges[k]), int(edges[k + 1]))

    def task(self, k: int) -> str:
        """What was asked of the robot in an episode."""
        named: list[str] = self.episodes["tasks"][k] if self.episodes.get("tasks") else []
        return named[0] if len(named) else self.tasks[0]

    def label(self, k: int) -> str:
        """How an episode ended, as far as the dataset tells: its outcome, or whether next.success was ever true."""
        told = self.episodes["outcome"][k] if "outcome" in self.episodes else None
        if told in ("success", "failure", "unknown"):
            return str(told)
        if "next.success" in self.features:
            return "success" if bool(self.frames(k)["next.success"].any()) else "failure"
        return "unknown"

    def span(self, k: int, camera: str) -> Span:
        """Where the pictures of an episode are, by video feature.

        Raises:
            DatasetError: the path leads out of the dataset.
        """
        chunk, file, start, stop = (self.episodes[f"videos/{camera}/{part}"][k] for part in (
            "chunk_index", "file_index", "from_timestamp", "to_timestamp"))
        relative = str(self.info["video_path"]).format(video_key=camera, chunk_index=chunk, file_index=file)
        path = (self.folder / relative).resolve()
        if self.folder.resolve() not in path.parents or not path.is_file():
            raise DatasetError(f"video {relative!r} is missing or leads out of the dataset", where=self.folder,
                               mend=MEND)
        return Span(path, float(start), float(stop))


def read_foreign(folder: Path) -> Foreign:
    """Open a foreign dataset; frames and videos are read when they are asked for.

    Raises:
        DatasetError: no LeRobot v3.0 dataset, or a table that cannot be read.
    """
    try:
        info = json.loads((folder / INFO).read_text(encoding="utf-8"))
        if info["codebase_version"] != "v3.0":
            raise DatasetError(f"a LeRobot dataset of format {info['codebase_version']!r}, v3.0 is read", where=folder,
                               mend="convert it: python -m lerobot.scripts.convert_dataset_v21_to_v30")
        columns: dict[str, list[Any]] = {}
        for path in sorted((folder / EPISODES).parents[1].rglob("*.parquet")):
            table = read_parquet(path)
            for name in (n for n in table.column_names if not n.startswith("stats/")):
                columns.setdefault(name, []).extend(table.column(name).to_pylist())
        if int(info["fps"]) != info["fps"] or not columns["length"]:
            raise ValueError("no episode, or a rate that is not whole")
        return Foreign(folder, info, columns, tuple(_tasks(folder)))
    except (OSError, ValueError, KeyError, TypeError, pa.ArrowException) as error:
        reason = one_line(error)[:160]
        raise DatasetError(f"not a LeRobot v3.0 dataset that can be read: {reason}", where=folder, mend=MEND) from error


def _tasks(folder: Path) -> list[str]:
    """Tasks by their number; the column of the texts is called as pandas has named the index."""
    table = read_parquet(folder / TASKS)
    if "task" in table.column_names:
        return read_tasks(folder)
    (name,) = (n for n in table.column_names if n != "task_index")
    named = dict(zip(table.column("task_index").to_pylist(), table.column(name).to_pylist(), strict=True))
    return [str(named[k]) for k in sorted(named)]


def _names(feature: str, given: object, width: int) -> tuple[str, ...]:
    """Names of values; datasets write them as a list, as {axis: list}, or not at all."""
    if isinstance(given, dict):
        given = next(iter(cast(Mapping[str, object], given).values()), None)
    if isinstance(given, list | tuple):
        names = tuple(map(str, cast(list[object], given)))
        if len(names) == width:
            return names
    last = feature.rpartition(".")[2]
    return (last,) if width == 1 else tuple(f"{last}_{k}" for k in range(width))
