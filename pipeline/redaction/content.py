"""What an episode holds, as bytes to hash: whatever file it lies in and at which place."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrow import read_parquet, to_rows
from pipeline.lerobot_view import layout
from pipeline.lerobot_view.opened import Opened, read_tasks
from schemas.dataset import DatasetVersion

PLACED = ("data/", "videos/", "stats/", "meta/", "dataset_", "repeated.")
DRAWN = ("episode_index", "weight", "group", "split", "length", "blob")
"""Columns that say where an episode lies or how often it is drawn: they change with its neighbours, and the hash of a
shard with the other variants in it."""


def data_of(opened: Opened, k: int) -> bytes:
    """The frames of episode k, without their numbers: name, type and values of each feature, little-endian."""
    number = int(opened.files[k])
    rows = opened.rows(number).slice(int(opened.starts[k]) - opened.first_row(number), int(opened.lengths[k]))
    parts: list[bytes] = []
    for name, width in opened.widths.items():
        if name not in layout.BOOKKEEPING:
            values = np.ascontiguousarray(to_rows(rows.column(name), width))
            parts.append(f"{name} {values.dtype.str} {values.shape}\0".encode() + values.tobytes())
    return b"".join(parts)


def meta_of(opened: Opened, k: int) -> bytes:
    """The row of episode k in the episodes table, as JSON: what it says of the episode itself."""
    names = [n for n in opened.episodes.column_names if not n.startswith(PLACED) and n not in DRAWN]
    row = opened.episodes.select(names).slice(k, 1).to_pylist()[0]
    return json.dumps(row, sort_keys=True, ensure_ascii=False, default=str).encode()


def as_built(folder: Path, version: dict[str, Any], files: dict[str, str]) -> Opened:
    """A folder that has no manifest yet.

    Args:
        folder: all else is there.
        version: what the manifest will say of it.
        files: digests of its files.
    """
    return Opened(folder, DatasetVersion.model_validate({**version, "digest": "0" * 64}),
                  json.loads((folder / layout.INFO).read_text(encoding="utf-8")), {"files": files},
                  read_parquet(folder / layout.EPISODES), tuple(read_tasks(folder)))
