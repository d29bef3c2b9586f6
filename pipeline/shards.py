"""Shards: the frames of many variant episodes in one file.

Variants have no recording of their own, since each can be made again from its parent, transform and
draws. One run of augmentation leaves one shard, and the shard is the blob of all its variants.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrow import pa, to_arrow, to_rows
from pipeline.errors import DatasetError, one_line
from pipeline.files import atomic
from pipeline.frames import FEATURES, Frames, Table, check_table

FORMAT = "hardcase-shard-1"


def write_shard(path: Path, episodes: Mapping[str, Frames]) -> None:
    """Write the frames of every episode, whole or not at all.

    Episodes lie in the order of their ids, uncompressed, in one Arrow record batch; nothing else is
    in the file, so the same frames give the same bytes, whatever the order they are handed over in.

    Args:
        path: the file, replaced if it is there.
        episodes: episode id -> its frames; may be empty.

    Raises:
        RecordingError: frames with a wrong shape or a value that is not finite; names the episode.
        DatasetError: frames that are not float32; names the episode.
    """
    ids = sorted(episodes)
    for episode in ids:
        check_frames(episodes[episode], f"episode {episode}")
    columns = {
        name: np.concatenate([np.empty((0, len(names)), np.float32), *(episodes[i].columns()[name] for i in ids)])
        for name, names in FEATURES.items()
    }
    index = json.dumps([[i, len(episodes[i])] for i in ids], separators=(",", ":"))
    batch = pa.record_batch({name: to_arrow(values) for name, values in columns.items()})
    batch = batch.replace_schema_metadata({"format": FORMAT, "episodes": index})
    with atomic(path) as stream, pa.ipc.new_file(stream, batch.schema) as writer:
        writer.write_batch(batch)


def read_shard(path: Path) -> dict[str, Frames]:
    """Episode id -> frames, in the order of the ids; the arrays are read-only.

    Raises:
        DatasetError: the file is missing, damaged or no shard.
    """
    try:
        with pa.ipc.open_file(pa.py_buffer(path.read_bytes())) as reader:
            return _episodes(reader)
    except FileNotFoundError as error:
        raise DatasetError("there is no such shard", where=path, mend="make the variants again: hardcase augment") \
            from error
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise DatasetError(f"not a whole shard of frames ({one_line(error)})", where=path,
                           mend="make the variants again: hardcase augment") from error


def check_frames[T: Table](frames: T, where: str) -> T:
    """Frames that are float32, finite and of the right shape, or the error that names the first fault."""
    for name, values in frames.columns().items():
        if values.dtype != np.float32 or values.ndim != 2:
            raise DatasetError(f"{name} is {values.dtype} of shape {values.shape}, must be float32 in rows",
                               where=where, mend="hand over Trace.frames() as it is")
    check_table(frames, where)
    return frames


def _episodes(reader: Any) -> dict[str, Frames]:
    metadata: dict[bytes, bytes] = reader.schema.metadata or {}
    if metadata.get(b"format") != FORMAT.encode() or reader.num_record_batches != 1:
        raise ValueError("no shard header")
    batch = reader.get_batch(0)
    batch.validate(full=True)
    columns = [to_rows(batch.column(name), len(names)) for name, names in FEATURES.items()]
    index: list[tuple[str, int]] = json.loads(metadata[b"episodes"])
    if any(length < 0 for _, length in index) or sum(length for _, length in index) != batch.num_rows:
        raise ValueError(f"{batch.num_rows} frames, the header promises {sum(n for _, n in index)}")
    episodes: dict[str, Frames] = {}
    start = 0
    for episode, length in index:
        episodes[episode] = Frames(*(values[start:start + length] for values in columns))
        start += length
    return episodes
