"""What a version can take over from its parent without writing it again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, read_parquet, to_rows
from pipeline.frames import FEATURES, Features
from pipeline.lerobot_view.exact import MEASURES
from pipeline.lerobot_view.layout import EPISODES, data_file, file_number, widths
from pipeline.lerobot_view.tables import Columns, Place, Row


@dataclass(frozen=True, slots=True)
class Shared:
    """The data files at the head of the parent whose every episode is still in its place."""

    files: tuple[str, ...]
    places: tuple[Place, ...]
    columns: Columns
    measures: NDArray[np.float64]
    """Statistics of each episode, shape (episodes, len(MEASURES), values)."""


def shared_with(parent: Path | None, rows: Sequence[Row], of: Features = FEATURES) -> Shared:
    """The longest run of whole data files of the parent that hold the first of these rows, in order.

    An episode is the same if its id, recording, segments and task are: then its row group is, bit for
    bit, since the indices count from the start of the version. A file with one episode that left
    or changed, and all files after it, must be written again.
    """
    columns = widths(of)
    if parent is None:
        return _nothing(columns)
    table = read_parquet(parent / EPISODES)
    kept: list[Place] = []
    chunks, files, starts, stops = (table.column(name).to_pylist() for name in (
        "data/chunk_index", "data/file_index", "dataset_from_index", "dataset_to_index"))
    old = list(zip(*(table.column(n).to_pylist() for n in ("episode_id", "blob", "segments", "tasks")), strict=True))
    new = [(row.episode.id, row.episode.blob, row.segments, [row.task]) for row in rows]
    numbers = [file_number(chunk, file) for chunk, file in zip(chunks, files, strict=True)]
    for number in sorted(set(numbers)):
        here = [k for k, n in enumerate(numbers) if n == number]
        if [old[k] for k in here] != new[here[0]:here[-1] + 1]:
            break
        kept += [Place(number, starts[k], stops[k]) for k in here]
    if not kept:
        return _nothing(columns)
    shared = tuple(data_file(number) for number in range(kept[-1].file + 1))
    return Shared(shared, tuple(kept), _read(parent, shared, columns), _measures(table, len(kept), columns))


def _nothing(widths: Mapping[str, int]) -> Shared:
    empty: Columns = {name: np.empty((0, width)) for name, width in widths.items()}
    return Shared((), (), empty, np.empty((0, len(MEASURES), sum(widths.values()))))


def _read(folder: Path, files: Sequence[str], widths: Mapping[str, int]) -> Columns:
    table = pa.concat_tables([read_parquet(folder / file) for file in files])
    return {name: to_rows(table.column(name), width) for name, width in widths.items()}


def _measures(table: Any, episodes: int, widths: Mapping[str, int]) -> NDArray[np.float64]:
    result = np.empty((episodes, len(MEASURES), sum(widths.values())))
    first = 0
    for name, width in widths.items():
        for k, measure in enumerate(MEASURES):
            column = table.column(f"stats/{name}/{measure}").slice(0, episodes)
            result[:, k, first:first + width] = to_rows(column, width)
        first += width
    return result
