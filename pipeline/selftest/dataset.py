"""A LeRobot folder in memory: copied, changed in one way, written again as if it had been built so."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import lists, pa, read_parquet, scalars, texts, to_rows
from pipeline.files import sha256_file
from pipeline.frames import FEATURES
from pipeline.lerobot_view.exact import MEASURES, as_matrix, by_feature, measure
from pipeline.lerobot_view.layout import EPISODES, INFO, MANIFEST, STATS, files_in, widths
from pipeline.lerobot_view.tables import write_frames


class Dataset:
    """One dataset that is being spoiled.

    Args:
        clean: the folder that it is copied from.
        folder: where the copy is written.
    """

    def __init__(self, clean: Path, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(clean, folder, copy_function=shutil.copyfile)  # without the modes: the copy is to be changed
        self.info: dict[str, Any] = json.loads((folder / INFO).read_text())
        self.stats: dict[str, Any] = json.loads((folder / STATS).read_text())
        self.episodes = read_parquet(folder / EPISODES)
        self._files = sorted((folder / "data").rglob("*.parquet"))
        parts = [read_parquet(path) for path in self._files]
        self._counts = [part.num_rows for part in parts]
        self.rows: dict[str, NDArray[Any]] = {
            name: np.concatenate([to_rows(part.column(name), width) for part in parts])
            for name, width in widths().items()}
        """Feature -> rows of all episodes, shape (rows, values)."""

    def column(self, name: str) -> list[Any]:
        """A column of the episodes table."""
        return self.episodes.column(name).to_pylist()

    def set_texts(self, name: str, values: list[str]) -> None:
        """Change a column of the episodes table."""
        self.episodes = self.episodes.set_column(self.episodes.column_names.index(name), name, texts(values))

    def count(self, episode: int, length: int) -> None:
        """Let every table count another number of rows for one episode, and number all rows anew; `rows` hold them."""
        lengths = self.column("length")
        edges = np.cumsum([0, *self._counts])
        file = int(np.searchsorted(edges, sum(lengths[:episode]), side="right")) - 1
        self._counts[file] += length - lengths[episode]
        lengths[episode] = length
        stops = np.cumsum(lengths)
        for name, values in {"length": np.array(lengths), "dataset_from_index": stops - lengths,
                             "dataset_to_index": stops}.items():
            self.episodes = self.episodes.set_column(self.episodes.column_names.index(name), name, scalars(values))
        self.rows["index"] = np.arange(stops[-1])[:, None]
        self.info["total_frames"] = int(stops[-1])
        self.measure()

    def parts(self) -> list[slice]:
        """The rows of every episode."""
        stops = np.cumsum(self.column("length")).tolist()
        return [slice(a, b) for a, b in zip([0, *stops], stops, strict=False)]

    def measure(self, *, each: bool = True) -> None:
        """Take the statistics of the rows as they are now, as whoever built it would have; of `each` episode, too."""
        if not all(np.isfinite(rows).all() for rows in self.rows.values() if rows.dtype.kind == "f"):
            return
        matrix = as_matrix(self.rows)
        fresh: Mapping[str, Any] = by_feature(measure(matrix), matrix.shape[1], FEATURES)
        self.stats |= {name: told for name, told in fresh.items() if name in self.stats}
        if each:
            self._put_statistics(np.stack([measure(matrix[:, part]) for part in self.parts()]))

    def _put_statistics(self, measures: NDArray[np.float64]) -> None:
        """Let the episodes table give these statistics, shape (episodes, MEASURES, values)."""
        first = 0
        for name, width in widths().items():
            columns = {m: measures[:, k, first:first + width] for k, m in enumerate(MEASURES)}
            columns["count"] = np.array(self.column("length"))[:, None]
            for what, values in columns.items():
                at = self.episodes.column_names.index(called := f"stats/{name}/{what}")
                column = lists(scalars(values.reshape(-1)), values.shape[1])
                self.episodes = self.episodes.set_column(at, called, column)
            first += width

    def write(self, *, sealed: bool = True) -> None:
        """Write everything; `sealed` lets the manifest, if there is one, promise these very bytes."""
        stops = np.cumsum(self._counts).tolist()
        for path, start, stop in zip(self._files, [0, *stops], stops, strict=False):
            lengths = [len(range(*s.indices(stop))) for s in self.parts() if start <= s.start < stop]
            write_frames(path, {name: rows[start:stop] for name, rows in self.rows.items()}, lengths)
        (self.folder / INFO).write_text(json.dumps(self.info, indent=1) + "\n")
        (self.folder / STATS).write_text(json.dumps(self.stats, indent=1) + "\n")
        pa.parquet.write_table(self.episodes, self.folder / EPISODES)
        if sealed and (self.folder / MANIFEST).exists():
            manifest = json.loads((self.folder / MANIFEST).read_text())
            manifest["files"] = {p.relative_to(self.folder).as_posix(): sha256_file(p) for p in files_in(self.folder)
                                 if p != self.folder / MANIFEST}
            (self.folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
