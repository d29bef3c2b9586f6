"""Samples of any robot's version: what LeRobotDataset gives for a frame, out of memory and in whole batches."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, read_parquet, to_rows
from pipeline.consent import NO_CONSENTS, Consents
from pipeline.errors import ConfigError, DatasetError
from pipeline.footage import FEATURE
from pipeline.lerobot_view import layout
from pipeline.lerobot_view.augmenting import Augment
from pipeline.lerobot_view.frame_cache import FOLDER, FrameCache
from pipeline.lerobot_view.frame_weights import Factors, chances
from pipeline.lerobot_view.incomplete import refuse_incomplete
from pipeline.lerobot_view.manifest import load_version, read_manifest
from pipeline.lerobot_view.training_data import Rows, needs_in, teaching

type Arrays = dict[str, NDArray[Any]]
"""Feature -> values, b samples each; KEY_is_pad where several frames of a key were asked for."""
type Deltas = Mapping[str, Sequence[int]]
"""Feature -> frames of it that a sample holds, counted from the sample's own: lerobot's delta_timestamps times fps."""

_LABELS = {"source": "source", "family": "family", "outcome": "outcome"}


@dataclass(frozen=True)
class Samples:
    """One version in memory, its pictures mapped into it; see `load`.

    A sample has the keys, shapes and values of a batch of LeRobotDataset: features by name, pictures as float32 of
    shape (3, height, width) in [0, 1], a feature of one value without an axis for it. What lies before the episode
    or after the run of frames that teach repeats the first or last frame, and KEY_is_pad says so.
    """

    columns: Arrays
    """Feature -> every frame, shape (n, values)."""
    tasks: tuple[str, ...]
    films: Mapping[str, tuple[NDArray[np.uint8], ...]]
    """Picture feature -> frames of each episode, shape (frames, height, width, 3) each."""
    starts: Rows
    stops: Rows
    last: Rows
    """For every frame, the last that a chunk may hold: the end of the run that teaches, or of the episode."""
    rows: Rows
    """Frames that may be drawn."""
    chance: NDArray[np.float64]
    """Their chances, added up; ends at 1."""
    held_out_rows: Rows
    lineages: tuple[str, ...]
    """Of each episode; see schemas Episode."""
    held_out_lineages: frozenset[str]

    @classmethod
    def load(cls, folder: Path, consents: Consents = NO_CONSENTS, *, factors: Factors | None = None,
             cameras: Sequence[str] | None = None, cache: Path | None = None) -> Self:
        """Read a version without lerobot or torch; its videos are decoded now unless they were before.

        Args:
            folder: where the version lies.
            consents: the consent records, and the moment of this use.
            factors: on the chances of frames.
            cameras: those whose pictures are wanted; all where None.
            cache: where decoded frames are kept; in the version's store where None.

        Raises:
            ConsentError: a person in it did not consent, or does not any more.
            ConfigError: a camera or a factor's name that it does not have.
            DatasetError: the folder is no version, or was changed after it was built.
        """
        version = load_version(folder)
        refuse_incomplete(version, folder)
        episodes = read_parquet(folder / layout.EPISODES)
        consents.check_needs(needs_in(episodes, folder), folder)
        info: dict[str, Any] = json.loads((folder / layout.INFO).read_text(encoding="utf-8"))
        columns = _columns(folder, info["features"])
        starts, stops = (to_rows(episodes.column(n), 1)[:, 0] for n in ("dataset_from_index", "dataset_to_index"))
        teaches, last = teaching(starts, stops, columns[layout.INTERVENTION])
        lengths = stops - starts
        train = np.repeat(np.array(episodes.column("split").to_pylist()) == "train", lengths)
        group = np.repeat(np.array(episodes.column("group").to_pylist()), lengths)
        groups = {name: np.flatnonzero(train & teaches & (group == name)) for name in version.weights}
        factor = (factors or Factors()).of(_labels(episodes, lengths), folder)
        rows, chance = chances(groups, version.weights, factor, folder)
        lineages = tuple(episodes.column("lineage").to_pylist())
        held = {i for i, s in zip(lineages, episodes.column("split").to_pylist(), strict=True) if s != "train"}
        films = _films(folder, info, episodes, cameras, FrameCache(cache or folder.parents[1] / FOLDER))
        return cls(columns, tuple(read_parquet(folder / layout.TASKS, ["task"]).column("task").to_pylist()), films,
                   starts, stops, np.where(last < 0, np.repeat(stops - 1, lengths), last), rows, chance,
                   np.flatnonzero(~train & teaches), lineages, frozenset(held))

    def draw(self, rng: np.random.Generator, batch: int) -> Rows:
        """Frames by their chances, with replacement, shape (batch,); equal generators draw equal frames."""
        return self.rows[np.searchsorted(self.chance, rng.random(batch), "right")]

    def sample(self, rng: np.random.Generator, batch: int, deltas: Deltas, augment: Augment | None = None,
               pictures: Literal["float", "bytes"] = "float") -> Arrays:
        """A training batch; its pictures go through `augment` if there is one. See `gather`."""
        return self.gather(self.draw(rng, batch), deltas, augment, rng, pictures)

    def held_out(self, deltas: Deltas) -> Arrays:
        """Every sample of the validation split, once and in order; may be empty."""
        return self.gather(self.held_out_rows, deltas)

    def gather(self, rows: Rows, deltas: Deltas, augment: Augment | None = None,
               rng: np.random.Generator | None = None, pictures: Literal["float", "bytes"] = "float") -> Arrays:
        """The samples of these frames, every feature.

        Args:
            rows: frames of the version, shape (b,).
            deltas: for the features of which more than the frame itself is wanted.
            augment: changes pictures; needs `rng`.
            rng: the only source of randomness.
            pictures: float32 in [0, 1], or bytes as they were decoded: a quarter of the memory.

        Raises:
            ConfigError: deltas of a feature that is not there; lists those that are.
        """
        if unknown := [name for name in deltas if name not in self.columns and name not in self.films]:
            raise ConfigError(f"there is no feature {unknown[0]!r}", where="deltas",
                              mend=f"use one of: {', '.join([*self.columns, *self.films])}")
        found: Arrays = {}
        for name, values in self.columns.items():
            at, pad = self._at(rows, deltas.get(name))
            taken = values.take(at, axis=0)
            found[name] = taken[..., 0] if values.shape[1] == 1 else taken
            if pad is not None:
                found[f"{name}_is_pad"] = pad
        for name in self.films:
            at, pad = self._at(rows, deltas.get(name))
            found[name] = self._pictures(name, at, augment, rng, pictures)
            if pad is not None:
                found[f"{name}_is_pad"] = pad
        return found

    def task_of(self, found: Arrays) -> list[str]:
        """What was asked of the robot in each sample of a batch, in words."""
        return [self.tasks[k] for k in found["task_index"].tolist()]

    def _at(self, rows: Rows, deltas: Sequence[int] | None) -> tuple[Rows, NDArray[np.bool_] | None]:
        """Which frames a feature is read at, shape (b,) or (b, deltas), and which of them are padding."""
        if deltas is None:
            return rows, None
        wanted = rows[:, None] + np.asarray(deltas, np.intp)
        first, last = self._first[rows][:, None], self.last[rows][:, None]
        return np.clip(wanted, first, last), (wanted < first) | (wanted > last)

    @cached_property
    def _first(self) -> Rows:
        """The first frame of every frame's episode."""
        return np.repeat(self.starts, self.stops - self.starts)

    def _pictures(self, name: str, at: Rows, augment: Augment | None, rng: np.random.Generator | None,
                  kind: str) -> NDArray[Any]:
        films, flat = self.films[name], at.reshape(-1)
        episodes = np.searchsorted(self.stops, flat, "right")
        inside = flat - self.starts[episodes]
        frames = np.empty((flat.size, *films[0].shape[1:]), np.uint8)
        for k, (episode, frame) in enumerate(zip(episodes.tolist(), inside.tolist(), strict=True)):
            frames[k] = films[episode][frame]
        if augment is not None and rng is not None:  # all frames of a sample are changed alike
            frames = augment(frames, rng, at.shape[1] if at.ndim > 1 else 1)
        channels = frames.transpose(0, 3, 1, 2)
        shape = (*at.shape, *channels.shape[1:])
        if kind == "bytes":
            return np.ascontiguousarray(channels).reshape(shape)
        floats = np.empty(channels.shape, np.float32)
        np.divide(channels, np.float32(255), out=floats)
        return floats.reshape(shape)


def _columns(folder: Path, features: Mapping[str, Any]) -> Arrays:
    tables: list[Any] = []
    while (path := folder / layout.data_file(len(tables))).exists():
        tables.append(read_parquet(path))
    table = pa.concat_tables(tables)
    return {name: to_rows(table.column(name), what["shape"][0]) for name, what in features.items()
            if what["dtype"] != "video"}


def _labels(episodes: Any, lengths: Rows) -> dict[str, NDArray[np.str_]]:
    found = {kind: np.repeat(np.array([v or "" for v in episodes.column(name).to_pylist()]), lengths)
             for kind, name in _LABELS.items()}
    parts = [(kind, stop - start) for text in episodes.column("segments").to_pylist()
             for kind, start, stop, _ in json.loads(text)]
    found["segment"] = np.repeat(np.array([kind for kind, _ in parts]), [n for _, n in parts])
    return found


def _films(folder: Path, info: Mapping[str, Any], episodes: Any, cameras: Sequence[str] | None,
           cache: FrameCache) -> dict[str, tuple[NDArray[np.uint8], ...]]:
    there = [name for name, what in info["features"].items() if what["dtype"] == "video"]
    if missing := [c for c in cameras or () if FEATURE + c not in there]:
        raise ConfigError(f"the version has no camera {missing[0]!r}", where=folder,
                          mend=f"use one of: {', '.join(n.removeprefix(FEATURE) for n in there) or 'none is there'}")
    files: dict[str, str] = read_manifest(folder)["files"]
    found: dict[str, tuple[NDArray[np.uint8], ...]] = {}
    for name in there if cameras is None else (FEATURE + c for c in cameras):
        parts = ("chunk_index", "file_index", "from_timestamp")
        columns = (episodes.column(f"videos/{name}/{part}").to_pylist() for part in parts)
        films: list[NDArray[np.uint8]] = []
        for chunk, file, start, length in zip(*columns, episodes.column("length").to_pylist(), strict=True):
            path = layout.VIDEO_PATH.format(video_key=name, chunk_index=chunk, file_index=file)
            first = round(start * info["fps"])
            film = cache.frames(folder / path, files[path])[first:first + length]
            if len(film) != length:
                raise DatasetError(f"{path} holds {len(film)} of {length} frames", where=folder,
                                   mend="build the version again: hardcase build")
            films.append(film)
        found[name] = tuple(films)
    return found
