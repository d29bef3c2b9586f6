"""Several versions in one training: batches drawn from each by its share, and nothing taught that one holds out."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from pipeline.errors import ConfigError, DatasetError
from pipeline.lerobot_view.augmenting import Augment
from pipeline.lerobot_view.samples import Arrays, Deltas, Samples


class Mixture:
    """Versions with the same features; each sample comes from one of them by chance.

    A lineage that one version holds out is drawn from none. Tasks are numbered anew over all versions.

    Args:
        parts: versions, each with its weight above 0; weights need not add up to 1.

    Raises:
        ConfigError: no version, or a weight that is not above 0.
        DatasetError: the versions differ in their features or the size of pictures, or all that one has is held out.
    """

    def __init__(self, parts: Sequence[tuple[Samples, float]]) -> None:
        if not parts or not all(0 < weight < np.inf for _, weight in parts):
            raise ConfigError(f"weights {[weight for _, weight in parts]}", where="mixture of versions",
                              mend="give at least one version, each with a weight above 0")
        held = frozenset[str]().union(*(samples.held_out_lineages for samples, _ in parts))
        self.tasks = tuple(dict.fromkeys(task for samples, _ in parts for task in samples.tasks))
        self.parts = tuple(self._joined(samples, held, number) for number, (samples, _) in enumerate(parts))
        self.shares = np.array([weight for _, weight in parts]) / sum(weight for _, weight in parts)
        for number, samples in enumerate(self.parts):
            if (mine := _shape(samples)) != (first := _shape(self.parts[0])):
                odd = next(name for name in (*first, *mine) if first.get(name) != mine.get(name))
                raise DatasetError(f"{odd} has {mine.get(odd, 'no')} values, version 0 has {first.get(odd, 'none')}",
                                   where=f"version {number} of the mixture", mend="mix versions of one robot and size")

    def sample(self, rng: np.random.Generator, batch: int, deltas: Deltas, augment: Augment | None = None,
               pictures: Literal["float", "bytes"] = "float") -> Arrays:
        """A training batch, version after version; see Samples.sample. Equal generators give equal batches."""
        counts = rng.multinomial(batch, self.shares).tolist()
        drawn = [samples.sample(rng, n, deltas, augment, pictures)
                 for samples, n in zip(self.parts, counts, strict=True) if n]
        return {name: np.concatenate([one[name] for one in drawn]) for name in drawn[0]}

    def task_of(self, found: Arrays) -> list[str]:
        """What was asked of the robot in each sample of a batch, in words."""
        return [self.tasks[k] for k in found["task_index"].tolist()]

    def _joined(self, samples: Samples, held: frozenset[str], number: int) -> Samples:
        """A version without what another holds out, its tasks numbered as in the mixture."""
        episode = np.searchsorted(samples.stops, samples.rows, "right")
        free = np.array([lineage not in held for lineage in samples.lineages])[episode]
        if not free.any():
            raise DatasetError("every lineage is held out in another version", where=f"version {number} of the mixture",
                               mend="leave the version out of the mixture")
        chance = np.cumsum(np.diff(samples.chance, prepend=0.0)[free])
        renumbered = np.array([self.tasks.index(task) for task in samples.tasks])
        columns = {**samples.columns, "task_index": renumbered[samples.columns["task_index"]]}
        return replace(samples, rows=samples.rows[free], chance=chance / chance[-1], columns=columns, tasks=self.tasks)


def _shape(samples: Samples) -> dict[str, tuple[int, ...]]:
    return {name: values.shape[1:] for name, values in samples.columns.items()} | {
        name: films[0].shape[1:] for name, films in samples.films.items()}
