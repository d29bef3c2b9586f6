"""Frames of a derived version: read from the files of its sources, given their new numbers, written bit for bit."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, scalars, to_rows
from pipeline.lerobot_view import layout
from pipeline.lerobot_view.exact import MEASURES, measure
from pipeline.lerobot_view.plan import Plan
from pipeline.lerobot_view.tables import write_row_groups

type Whole = NDArray[np.int64]


def moved(plan: Plan) -> Any:
    """The frames of all episodes after those whose files are shared, as one table; None where there are none.

    Raises:
        DatasetError: a data file of a source is missing or was changed.
    """
    draft, head = plan.draft, plan.head
    if head == len(plan.ids):
        return None
    parts: list[Any] = []
    tasks: list[Whole] = []
    lengths = plan.lengths[head:]
    for s, number, first, count in _runs(plan):
        source = draft.sources[s]
        rows = source.rows(number).select([*draft.parent.widths])
        parts.append(rows.slice(first - source.first_row(number), count))
        tasks.append(plan.task_index[s][to_rows(parts[-1].column("task_index"), 1)[:, 0]])
    frame = np.arange(int(lengths.sum())) - np.repeat(plan.firsts[head:] - plan.firsts[head], lengths)
    numbers: dict[str, NDArray[Any]] = {
        "timestamp": (frame / draft.parent.fps).astype(np.float32), "frame_index": frame,
        "episode_index": np.repeat(np.arange(head, len(plan.ids)), lengths),
        "index": np.arange(plan.firsts[head], plan.frames), "task_index": np.concatenate(tasks)}
    table = pa.concat_tables(parts)
    for name, values in numbers.items():
        table = table.set_column(table.column_names.index(name), name, scalars(values))
    return table


def _runs(plan: Plan) -> Iterator[tuple[int, int, int, int]]:
    """Source, number of the data file, global row of the first frame there, and frames of every run of moved frames.

    Frames that follow each other in one file are one run: a slice costs as much as the file has row groups.
    """
    draft, head = plan.draft, plan.head
    source, row, length = draft.source[head:], draft.row[head:], plan.lengths[head:]
    file, first = np.empty_like(row), np.empty_like(row)
    for s, opened in enumerate(draft.sources):
        here = source == s
        file[here], first[here] = opened.files[row[here]], opened.starts[row[here]]
    first += draft.start[head:]
    apart = (np.diff(source) != 0) | (np.diff(file) != 0) | (first[1:] != first[:-1] + length[:-1])
    edges = [0, *(np.flatnonzero(apart) + 1).tolist(), len(row)]
    for a, b in pairwise(edges):
        yield int(source[a]), int(file[a]), int(first[a]), int(length[a:b].sum())


def write_moved(folder: Path, plan: Plan, table: Any) -> Whole:
    """Write the data files after the shared ones; the number of the file of every episode, shape (episodes,)."""
    numbers = plan.draft.parent.files[:plan.head]
    if table is None:
        return numbers
    limit = max(1, layout.DATA_FILE_MB * 2**20 // max(1, table.nbytes // len(table)))
    groups: list[list[int]] = [[]]
    for length in plan.lengths[plan.head:].tolist():
        if groups[-1] and sum(groups[-1]) + length > limit:
            groups.append([])
        groups[-1].append(length)
    first, row = int(numbers.max(initial=-1)) + 1, 0
    for number, group in enumerate(groups, first):
        write_row_groups(folder / layout.data_file(number), table.slice(row, sum(group)), group)
        row += sum(group)
    added = np.repeat(np.arange(first, first + len(groups)), [len(g) for g in groups])
    return np.append(numbers, added)


def as_matrix(table: Any, widths: Mapping[str, int]) -> NDArray[np.float64]:
    """All number features below each other, shape (values, rows), as pipeline.lerobot_view.exact measures them."""
    matrix = np.empty((sum(widths.values()), len(table)))
    row = 0
    for name, width in widths.items():
        column = table.column(name)
        if pa.types.is_boolean(column.type):
            column = column.cast(pa.uint8())
        matrix[row:row + width] = to_rows(column, width).T
        row += width
    return matrix


def measured(plan: Plan, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Statistics of each episode whose frames were moved, shape (episodes, MEASURES, values)."""
    edges = np.append(plan.firsts[plan.head:], plan.frames) - plan.firsts[plan.head]
    each = [measure(matrix[:, a:b]) for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)]
    return np.stack(each) if each else np.empty((0, len(MEASURES), len(matrix)))


def whole_matrix(plan: Plan, moved_rows: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Every frame of the version, the shared ones read as well, shape (values, frames)."""
    parent = plan.draft.parent
    shared = [as_matrix(parent.rows(n), parent.widths) for n in np.unique(parent.files[:plan.head]).tolist()]
    return np.concatenate([*shared, *([] if moved_rows is None else [moved_rows])], axis=1)
