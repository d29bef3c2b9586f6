"""The frames of one conversion in one Arrow file: a record batch an episode, features first, image numbers last."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, to_arrow, to_rows
from pipeline.errors import DatasetError
from pipeline.frames import Features, FeatureTable

FORMAT = "hardcase-frames-1"
IMAGE = "image."
"""Columns image.NAME: number of the camera's image that a frame uses."""

type Column = NDArray[np.float32] | NDArray[np.int64]


class FrameWriter:
    """Writes episodes as they are made; equal frames give equal bytes."""

    def __init__(self, file: Path) -> None:
        self.episodes = 0
        self._file = file
        self._writer: Any = None

    def append(self, columns: Mapping[str, Column]) -> None:
        """Take one episode: name -> array (frames, values)."""
        batch = pa.record_batch({name: to_arrow(values) for name, values in columns.items()})
        batch = batch.replace_schema_metadata({"format": FORMAT})
        self._writer = self._writer or pa.ipc.new_file(str(self._file), batch.schema)
        self._writer.write_batch(batch)
        self.episodes += 1

    def close(self) -> None:
        """Finish the file; there is none where no episode was made."""
        if self._writer is not None:
            self._writer.close()


class FrameFile:
    """The episodes of a conversion by number."""

    def __init__(self, file: Path, features: Features) -> None:
        """Open a file of `FrameWriter`.

        Raises:
            DatasetError: it is missing, damaged or something else.
        """
        self._file, self._features = file, features
        try:
            self._reader: Any = pa.ipc.open_file(pa.memory_map(str(file)))
            metadata: dict[bytes, bytes] = self._reader.schema.metadata or {}
            if metadata.get(b"format") != FORMAT.encode():
                raise ValueError("no header of frames")
        except (pa.ArrowException, OSError, ValueError) as error:
            raise self._damaged(error) from error

    def table(self, number: int) -> FeatureTable:
        """Features and skews of episode 0, 1, 2, ...; the arrays are read-only."""
        batch = self._batch(number)
        try:
            values = {name: to_rows(batch.column(name), len(names)) for name, names in self._features.items()}
        except (KeyError, ValueError) as error:
            raise self._damaged(error) from error
        return FeatureTable(self._features, values)

    def images(self, number: int, camera: str) -> NDArray[np.int64]:
        """Which image of a camera each frame of an episode uses, shape (frames,)."""
        return to_rows(self._batch(number).column(IMAGE + camera), 1)[:, 0]

    def _batch(self, number: int) -> Any:
        try:
            batch = self._reader.get_batch(number)
            batch.validate(full=True)
        except (pa.ArrowException, ValueError) as error:
            raise self._damaged(error) from error
        return batch

    def _damaged(self, error: Exception) -> DatasetError:
        return DatasetError(f"not a whole file of frames ({str(error).splitlines()[0] if str(error) else error!r})",
                            where=self._file, mend="convert the log again: hardcase ingest")
