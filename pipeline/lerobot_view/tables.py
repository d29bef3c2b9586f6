"""The tables of a version: frames by file, episodes, tasks."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import lists, pa, scalars, texts, to_arrow
from pipeline.frames import FEATURES, Features, Table
from pipeline.lerobot_view.exact import MEASURES
from pipeline.lerobot_view.layout import BOOKKEEPING, INTERVENTION, chunk_and_file, widths
from schemas.episode import Episode

type Columns = dict[str, NDArray[Any]]
"""Feature name -> rows of shape (n, width)."""


@dataclass(frozen=True, slots=True)
class Row:
    """One episode and its place in a version."""

    episode: Episode
    task: str
    """What was asked of the robot, in words."""
    lineage: str
    """Id that it shares with everything made from the same demonstration."""
    split: Literal["train", "held_out"]
    group: str
    """Key of the weights: base or corrections."""
    weight: float
    """Chance that a training sample comes from this episode; 0 if it is held out."""
    consents: str = ""
    """Ids of the consent records that it rests on, comma between; empty where nobody was recorded."""

    @property
    def segments(self) -> str:
        """Who commanded which frames, as JSON: [[kind, start, stop, actor], ...]."""
        parts = [[s.kind, s.start, s.stop, s.actor] for s in self.episode.segments]
        return json.dumps(parts, separators=(",", ":"))


@dataclass(frozen=True, slots=True)
class Place:
    """Where the frames of an episode lie."""

    file: int
    start: int
    """Global row of the first frame."""
    stop: int


def taught(episode: Episode) -> int:
    """How many frames of an episode a policy learns from: those of the intervention if there was one, else all."""
    return sum(s.stop - s.start for s in episode.segments if s.kind == "intervention") or episode.frames


def frame_columns(rows: Sequence[Row], frames: Sequence[Table], tasks: Sequence[str], *, fps: int,
                  first_episode: int, first_frame: int) -> Columns:
    """All feature columns of some episodes that follow each other in a version."""
    lengths = np.array([len(f) for f in frames])
    total = int(lengths.sum())
    starts = np.cumsum(lengths) - lengths
    frame_index = np.arange(total) - np.repeat(starts, lengths)
    intervention = np.zeros(total, np.int64)
    for row, start in zip(rows, starts.tolist(), strict=True):
        for segment in row.episode.segments:
            if segment.kind == "intervention":
                intervention[start + segment.start:start + segment.stop] = 1
    taken = [f.columns() for f in frames]
    columns: Columns = {name: np.concatenate([f[name] for f in taken]) for name in frames[0].names}
    scalars: Columns = {
        INTERVENTION: intervention,
        "timestamp": (frame_index / fps).astype(np.float32),
        "frame_index": frame_index,
        "episode_index": np.repeat(np.arange(len(rows)) + first_episode, lengths),
        "index": np.arange(total) + first_frame,
        "task_index": np.repeat([tasks.index(row.task) for row in rows], lengths),
    }
    return columns | {name: values[:, None] for name, values in scalars.items()}


def write_frames(path: Path, columns: Columns, lengths: Sequence[int]) -> None:
    """One data file from the frames of episodes that have these lengths."""
    write_row_groups(path, pa.table({name: to_arrow(values) for name, values in columns.items()}), lengths)


def write_row_groups(path: Path, table: Any, lengths: Sequence[int]) -> None:
    """One data file, one row group an episode, so that a reader can fetch a single episode."""
    few_values = [INTERVENTION, "episode_index", "task_index"]
    path.parent.mkdir(parents=True, exist_ok=True)
    with pa.parquet.ParquetWriter(path, table.schema, compression="snappy", use_dictionary=few_values,
                                  write_statistics=[*BOOKKEEPING]) as writer:
        start = 0
        for length in lengths:
            writer.write_table(table.slice(start, length))
            start += length


def write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """tasks.parquet as pandas would write a frame with the index `task`, without importing pandas."""
    def column(name: str, kind: str, numpy: str) -> dict[str, object]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}

    pandas = {
        "index_columns": ["task"],
        "column_indexes": [{"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object",
                            "metadata": {"encoding": "UTF-8"}}],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "pandas_version": "2.3.3",
    }
    table = pa.table({"task_index": scalars(np.arange(len(tasks))), "task": texts(tasks)})
    path.parent.mkdir(parents=True, exist_ok=True)
    pa.parquet.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), path)


def write_episodes(path: Path, rows: Sequence[Row], places: Sequence[Place], measures: NDArray[np.float64],
                   of: Features = FEATURES, more: Mapping[str, Any] = MappingProxyType({})) -> None:
    """The episodes table: what lerobot asks for, statistics (episodes, MEASURES, values), `more`, then our own."""
    count = len(rows)
    columns: dict[str, Any] = {
        "episode_index": _integers(range(count)),
        "tasks": lists(texts([row.task for row in rows]), 1),
        "length": _integers(p.stop - p.start for p in places),
        "data/chunk_index": _integers(chunk_and_file(p.file)[0] for p in places),
        "data/file_index": _integers(chunk_and_file(p.file)[1] for p in places),
        "dataset_from_index": _integers(p.start for p in places),
        "dataset_to_index": _integers(p.stop for p in places),
    }
    first = 0
    for name, width in widths(of).items():
        for k, measure in enumerate(MEASURES):
            columns[f"stats/{name}/{measure}"] = lists(scalars(measures[:, k, first:first + width].reshape(-1)), width)
        columns[f"stats/{name}/count"] = lists(columns["length"], 1)
        first += width
    columns |= {"meta/episodes/chunk_index": _integers([0] * count), "meta/episodes/file_index": _integers([0] * count)}
    path.parent.mkdir(parents=True, exist_ok=True)
    pa.parquet.write_table(pa.table({**columns, **more, **_own_columns(rows)}), path)


def _integers(values: Iterable[int]) -> Any:
    return scalars(np.fromiter(values, np.int64))


def _own_columns(rows: Sequence[Row]) -> dict[str, Any]:
    """Where each episode comes from; lerobot reads columns that it does not know without a word."""
    episodes = [row.episode for row in rows]
    origin: dict[str, list[str | None]] = {
        "episode_id": [e.id for e in episodes],
        "source": [e.origin for e in episodes],
        "parent": [e.parent for e in episodes],
        "transform": [e.transform for e in episodes],
        "policy": [e.policy for e in episodes],
        "outcome": [e.outcome.label for e in episodes],
        "trigger": [e.outcome.trigger for e in episodes],
        "family": [e.outcome.family for e in episodes],
        "stratum": [e.scene.stratum for e in episodes],
        "blob": [e.blob for e in episodes],
        "segments": [row.segments for row in rows],
        "lineage": [row.lineage for row in rows],
        "split": [row.split for row in rows],
        "group": [row.group for row in rows],
        "consents": [row.consents for row in rows],
    }
    columns = {name: texts(values) for name, values in origin.items()}
    columns["generation"] = _integers(e.generation for e in episodes)
    columns["weight"] = scalars(np.array([row.weight for row in rows]))
    return columns
