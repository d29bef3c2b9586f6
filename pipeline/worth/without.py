"""A version without some of its episodes, as training sees it: rows are left out at the loader, nothing is written.

What is left is drawn exactly as from the version that `hardcase derive --drop` would make: groups keep their shares,
a group that has nothing left gives its share to the others. Both train to the same bits (tests/worth/test_without.py).
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.lerobot_view.training_data import Rows, TrainingData


def without(data: TrainingData, episodes: Sequence[str], batch: Collection[str]) -> TrainingData:
    """The training data without the episodes of a batch.

    Args:
        data: a version in memory.
        episodes: ids of its episodes, in the order of the version.
        batch: ids of those to leave out; ids that the version does not hold are refused.

    Raises:
        DatasetError: an id is not of this version, or nothing would be left to train on.
    """
    out = frozenset(batch)
    if strange := sorted(out - set(episodes)):
        raise DatasetError(f"episode {strange[0]} is not in the version", where=f"a batch of {len(out)} episodes",
                           mend="name episodes of the version: hardcase datasets VERSION")
    stays = np.repeat(np.array([e not in out for e in episodes]), data.stops - data.starts)
    rows = {name: _of(group, stays) for name, group in data.rows.items()}
    rows = {name: group for name, group in rows.items() if group.size}
    if not rows:
        raise DatasetError("without the batch nothing is left to train on", where=f"{len(episodes)} episodes",
                           mend="name a batch that is a part of the version")
    total = sum(data.weights[name] for name in rows)
    return replace(data, rows=rows, weights={name: data.weights[name] / total for name in rows},
                   held_out_rows=_of(data.held_out_rows, stays))


def _of(rows: Rows, stays: NDArray[np.bool_]) -> Rows:
    return rows[stays[rows]]
