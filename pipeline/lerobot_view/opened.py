"""A dataset folder opened for derivation: its tables as they are, columns that we do not know included."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import read_parquet
from pipeline.errors import DatasetError
from pipeline.files import sha256_file
from pipeline.lerobot_view import layout
from pipeline.lerobot_view.incomplete import refuse_starts
from pipeline.lerobot_view.manifest import read_manifest
from pipeline.query import Fields
from schemas.dataset import DatasetVersion

FIELDS: Fields = {
    "id": "text", "source": "text", "outcome": "text", "family": "text", "trigger": "text", "stratum": "text",
    "parent": "text", "policy": "text", "split": "text", "group": "text", "task": "text", "lineage": "text",
    "generation": "number", "frames": "number", "weight": "number"}
"""What a query may ask of the episodes of a version."""

_COLUMN = {"id": "episode_id", "frames": "length"}


@dataclass(frozen=True)
class Opened:
    """One version, read from its folder; data files are read when they are asked for."""

    folder: Path
    version: DatasetVersion
    """As it was catalogued."""
    info: Mapping[str, Any]
    """meta/info.json."""
    manifest: Mapping[str, Any]
    """meta/hardcase.json."""
    episodes: Any
    """The whole episodes table, statistics included."""
    tasks: tuple[str, ...]
    """In the order of task_index."""
    rewrite: Callable[[int, Any], Any] | None = None
    """What becomes of a data file as it is read: its number and table -> its table; None: nothing."""
    rewritten: frozenset[int] = frozenset()
    """Numbers of the data files that another version may therefore not share."""
    _files: dict[int, Any] = field(default_factory=dict[int, Any])

    def __len__(self) -> int:
        return len(self.episodes)

    @property
    def hashes(self) -> Mapping[str, str]:
        """sha256 of every file but the manifest, as the manifest vouches for it."""
        return self.manifest["files"]

    @property
    def fps(self) -> int:
        """Frames a second."""
        return int(self.info["fps"])

    @cached_property
    def ids(self) -> list[str]:
        """Id of every episode, in order."""
        return list(map(str, self.texts("episode_id")))

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """Global row of the first frame of each episode."""
        return self.integers("dataset_from_index")

    @cached_property
    def lengths(self) -> NDArray[np.int64]:
        """Frames of each episode."""
        return self.integers("length")

    @cached_property
    def files(self) -> NDArray[np.int64]:
        """Number of the data file that holds each episode."""
        return self.integers("data/chunk_index") * layout.FILES_PER_CHUNK + self.integers("data/file_index")

    @property
    def cameras(self) -> tuple[str, ...]:
        """Features that are videos."""
        return tuple(name for name, what in self.info["features"].items() if what["dtype"] == "video")

    @property
    def widths(self) -> dict[str, int]:
        """Feature of the data files -> values a frame, in column order."""
        return {name: int(np.prod(list[int](what["shape"]))) for name, what in self.info["features"].items()
                if what["dtype"] != "video"}

    def texts(self, name: str) -> list[str | None]:
        """A column of the episodes table; None for every episode where an older version has no such column."""
        there = name in self.episodes.column_names
        return self.episodes.column(name).to_pylist() if there else [None] * len(self)

    def integers(self, name: str) -> NDArray[np.int64]:
        """A column of whole numbers of the episodes table."""
        return np.asarray(self.episodes.column(name).to_pylist(), np.int64)

    def asked(self, field: str) -> NDArray[Any]:
        """The value of one of FIELDS for every episode, as queries compare it."""
        if FIELDS[field] == "number":
            return np.asarray(self.episodes.column(_COLUMN.get(field, field)).to_pylist(), np.float64)
        values = ([tasks[0] for tasks in self.texts("tasks") if tasks] if field == "task"
                  else self.texts(_COLUMN.get(field, field)))
        return np.array(values, object)

    def rows(self, file: int) -> Any:
        """A data file, read once and checked against the manifest.

        Raises:
            DatasetError: it is missing or was changed.
        """
        if file not in self._files:
            name = layout.data_file(file)
            self.vouch(name)
            table = read_parquet(self.folder / name)
            self._files[file] = self.rewrite(file, table) if self.rewrite is not None else table
        return self._files[file]

    def first_row(self, file: int) -> int:
        """Global row of the first frame of a data file."""
        return int(self.starts[np.argmax(self.files == file)])

    def vouch(self, name: str) -> None:
        """Return when a file holds the bytes that the manifest promises.

        Raises:
            DatasetError: it is missing or was changed.
        """
        path = self.folder / name
        there = path.is_file()
        if not there or sha256_file(path) != self.hashes.get(name):
            raise DatasetError(f"{name} {'was changed' if there else 'is missing'} after the version was built",
                               where=self.folder,
                               mend=f"remove the folder and build the version again: rm -r {self.folder}")


def open_version(folder: Path, version: DatasetVersion) -> Opened:
    """Open a version's folder; every table but the data files is read and checked.

    Raises:
        DatasetError: no version, another one than was catalogued, or a table that is missing or was changed.
    """
    refuse_starts(folder)
    manifest = read_manifest(folder)
    if manifest["version"]["id"] != version.id:
        raise DatasetError(f"the folder holds version {manifest['version']['id']}, not {version.id}", where=folder,
                           mend=f"remove the folder and build the version again: rm -r {folder}")
    opened = Opened(folder, version, {}, manifest, None, ())
    for name in (layout.INFO, layout.STATS, layout.TASKS, layout.EPISODES):
        opened.vouch(name)
    return Opened(folder, version, json.loads((folder / layout.INFO).read_text(encoding="utf-8")), manifest,
                  read_parquet(folder / layout.EPISODES), tuple(read_tasks(folder)))


def read_tasks(folder: Path) -> list[str]:
    """The tasks of a folder in the order of task_index."""
    table = read_parquet(folder / layout.TASKS)
    named = dict(zip(table.column("task_index").to_pylist(), table.column("task").to_pylist(), strict=True))
    return [named[k] for k in sorted(named)]


def refuse_other_features(found: Mapping[str, Any], expected: Mapping[str, Any], *, where: object) -> None:
    """Return when two info.json agree in robot, rate and features, the names of values included.

    Raises:
        DatasetError: they do not; names the first thing that differs, in one line.
    """
    mend = "add only versions of the same robot, rate and features; see both: hardcase diff"
    for key, called in (("robot_type", "robot"), ("fps", "rate")):
        if found.get(key) != expected.get(key):
            raise DatasetError(f"the {called} is {found.get(key)!r}, {expected.get(key)!r} is expected", where=where,
                               mend=mend)
    mine, theirs = expected["features"], found["features"]
    for name in dict.fromkeys((*mine, *theirs)):
        if name not in theirs or name not in mine:
            raise DatasetError(f"feature {name} {'is missing' if name not in theirs else 'is not expected'}",
                               where=where, mend=mend)
        for key in ("dtype", "shape", "names"):
            if theirs[name].get(key) != mine[name].get(key):
                raise DatasetError(f"feature {name} has {key} {theirs[name].get(key)}, {mine[name].get(key)} is "
                                   "expected", where=where, mend=mend)
