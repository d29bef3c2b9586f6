"""The episodes table of a derived version: that of its sources, with what changed put in its place."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import lists, pa, scalars, texts
from pipeline.lerobot_view import filmed
from pipeline.lerobot_view.exact import MEASURES
from pipeline.lerobot_view.filmed import ByCamera
from pipeline.lerobot_view.layout import FILES_PER_CHUNK
from pipeline.lerobot_view.plan import Plan


def write_derived_episodes(path: Path, plan: Plan, numbers: NDArray[np.int64], measures: NDArray[np.float64],
                           clips: ByCamera) -> None:
    """Write the table; a column that we do not know stays with its episode.

    Args:
        path: the file.
        plan: what the version holds.
        numbers: number of the data file of each episode, shape (episodes,).
        measures: statistics of the episodes after plan.head, shape (moved, MEASURES, values).
        clips: the videos.
    """
    table = _taken(plan)
    columns: dict[str, Any] = dict(zip(table.column_names, table.columns, strict=True))
    changed: dict[str, Any] = _counted(plan, numbers) | {
        "outcome": texts(plan.outcome), "trigger": texts(plan.trigger), "family": texts(plan.family),
        "segments": texts(plan.segments), "split": texts(plan.split), "group": texts(plan.weighed.groups),
        "weight": scalars(plan.weighed.weights)}
    if len(measures):
        changed |= _statistics(columns, plan, measures)
    if clips:
        changed |= filmed.episode_columns(clips, plan.draft.parent.fps)
    columns |= {name: _cast(column, columns[name].type) if name in columns else column
                for name, column in changed.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    pa.parquet.write_table(pa.table(columns), path)


def _taken(plan: Plan) -> Any:
    """The rows of the sources' tables, in the order of the plan."""
    draft = plan.draft
    table = draft.parent.episodes
    if len(draft.sources) > 1:
        table = pa.concat_tables([s.episodes for s in draft.sources], promote_options="default")
    before = np.cumsum([0, *(len(s) for s in draft.sources[:-1])])
    rows = draft.row + before[draft.source]
    if len(rows) == len(table) and (rows == np.arange(len(rows))).all():
        return table
    runs = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)  # slices cost nothing, unlike a take of nested lists
    return pa.concat_tables([table.slice(int(run[0]), len(run)) for run in runs])


def _counted(plan: Plan, numbers: NDArray[np.int64]) -> dict[str, Any]:
    """Numbers and places of the episodes."""
    count, zeros = len(plan.ids), scalars(np.zeros(len(plan.ids), np.int64))
    return {
        "episode_index": scalars(np.arange(count)), "length": scalars(plan.lengths),
        "data/chunk_index": scalars(numbers // FILES_PER_CHUNK), "data/file_index": scalars(numbers % FILES_PER_CHUNK),
        "dataset_from_index": scalars(plan.firsts), "dataset_to_index": scalars(plan.firsts + plan.lengths),
        "meta/episodes/chunk_index": zeros, "meta/episodes/file_index": zeros}


def _statistics(before: Mapping[str, Any], plan: Plan, measures: NDArray[np.float64]) -> dict[str, Any]:
    """Statistics of the episodes that were moved, after those of the ones that were not."""
    columns: dict[str, Any] = {}
    first = 0
    for name, width in plan.draft.parent.widths.items():
        for k, measure in enumerate(MEASURES):
            new = lists(scalars(measures[:, k, first:first + width].reshape(-1)), width)
            columns[f"stats/{name}/{measure}"] = _after(before[f"stats/{name}/{measure}"], plan.head, new)
        counts = lists(scalars(plan.lengths[plan.head:]), 1)
        columns[f"stats/{name}/count"] = _after(before[f"stats/{name}/count"], plan.head, counts)
        first += width
    return columns


def _after(old: Any, head: int, new: Any) -> Any:
    parts: Sequence[Any] = old.slice(0, head).chunks
    return pa.chunked_array([*parts, _cast(new, old.type)], type=old.type)


def _cast(column: Any, kind: Any) -> Any:
    return column if column.type == kind else column.cast(kind)
