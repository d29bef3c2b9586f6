"""The frames of one conversion in one Arrow file: episodes below each other, features first, image numbers last."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import opened, pa, to_arrow, to_rows
from pipeline.errors import DatasetError, one_line
from pipeline.frames import FeatureTable
from schemas.conversion import Converted

FORMAT = "hardcase-frames-1"
IMAGE = "image."
"""Columns image.NAME: number of the camera's image that a frame uses."""

type Column = NDArray[np.float32] | NDArray[np.int64]


class FrameWriter:
    """Writes frames as they are made, a record batch a piece; equal frames give equal bytes."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._writer: Any = None

    def append(self, columns: Mapping[str, Column]) -> None:
        """Take some frames: name -> array (frames, values)."""
        batch = pa.record_batch({name: to_arrow(values) for name, values in columns.items()})
        batch = batch.replace_schema_metadata({"format": FORMAT})
        self._writer = self._writer or pa.ipc.new_file(str(self._file), batch.schema)
        self._writer.write_batch(batch)

    def close(self) -> None:
        """Finish the file; there is none where no episode was made."""
        if self._writer is not None:
            self._writer.close()


class FrameFile:
    """The episodes of a conversion by number."""

    def __init__(self, file: Path, made: Converted) -> None:
        """Open a file of `FrameWriter`.

        Args:
            file: the file.
            made: what the conversion said of it.

        Raises:
            DatasetError: it is missing, damaged or something else.
        """
        self._file, self._features = file, made.features
        try:
            self._reader, rows = opened(file, FORMAT)
            self._batches, self._episodes = _edges(rows), _edges([span.frames for span in made.spans])
            if self._batches[-1] != self._episodes[-1]:
                raise ValueError(f"{self._batches[-1]} frames, {self._episodes[-1]} were made")
        except (pa.ArrowException, OSError, ValueError) as error:
            raise self._damaged(error) from error

    def table(self, number: int) -> FeatureTable:
        """Features and skews of episode 0, 1, 2, ...; the arrays are read-only."""
        columns = self._columns(number, {name: len(names) for name, names in self._features.items()})
        return FeatureTable(self._features, columns)

    def images(self, number: int, camera: str) -> NDArray[np.int64]:
        """Which image of a camera each frame of an episode uses, shape (frames,)."""
        return self._columns(number, {IMAGE + camera: 1})[IMAGE + camera][:, 0]

    def _columns(self, number: int, widths: Mapping[str, int]) -> dict[str, NDArray[Any]]:
        start, stop = self._episodes[number:number + 2].tolist()
        low, high = np.searchsorted(self._batches, [start, stop - 1], "right") - 1
        found: dict[str, list[NDArray[Any]]] = {name: [] for name in widths}
        try:
            for k in range(int(low), int(high) + 1):
                first = int(self._batches[k])
                batch = self._reader.get_batch(k)
                batch.validate(full=True)
                for name, width in widths.items():
                    rows = to_rows(batch.column(name), width)
                    found[name].append(rows[max(start - first, 0):stop - first])
        except (pa.ArrowException, KeyError, ValueError) as error:
            raise self._damaged(error) from error
        return {name: parts[0] if len(parts) == 1 else np.concatenate(parts) for name, parts in found.items()}

    def _damaged(self, error: Exception) -> DatasetError:
        return DatasetError(f"not a whole file of frames ({one_line(error)})",
                            where=self._file, mend="convert the log again: hardcase ingest")


def _edges(lengths: Sequence[int]) -> NDArray[np.int64]:
    """Where each of some runs begins, and where the last one ends."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(np.array(lengths, np.int64))])
