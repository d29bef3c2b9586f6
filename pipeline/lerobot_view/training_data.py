"""Training data in memory: a version's arrays, and batches gathered from them by index."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, read_parquet, to_rows
from pipeline.consent import NO_CONSENTS, Consents
from pipeline.errors import DatasetError
from pipeline.footage import SKEW
from pipeline.frames import FEATURES, Features
from pipeline.lerobot_view.agreement import features_in, refuse_others
from pipeline.lerobot_view.incomplete import refuse_incomplete
from pipeline.lerobot_view.layout import EPISODES, INTERVENTION, data_file
from pipeline.lerobot_view.manifest import load_version

type Rows = NDArray[np.intp]


class Batch(NamedTuple):
    """b samples: what was seen at a frame, and the actions from that frame on."""

    state: NDArray[np.float32]
    """observation.state, shape (b, 16)."""
    environment: NDArray[np.float32]
    """observation.environment_state, shape (b, 7)."""
    actions: NDArray[np.float32]
    """action, shape (b, chunk, 5); past the end the last action is repeated."""
    mask: NDArray[np.bool_]
    """True where the action was really commanded, False where it is padding, shape (b, chunk)."""


@dataclass(frozen=True, slots=True)
class TrainingData:
    """One version in memory, the training split and the validation split.

    A sample starts at a frame that teaches and ends with its run of such frames. Of an episode with an
    intervention only the intervention teaches, because what the policy did before led to the failure;
    of any other episode every frame teaches.
    """

    state: NDArray[np.float32]
    """Every frame of the version, shape (n, 16)."""
    environment: NDArray[np.float32]
    """Shape (n, 7)."""
    action: NDArray[np.float32]
    """Shape (n, 5)."""
    starts: Rows
    """First row of each episode, shape (episodes,)."""
    stops: Rows
    """Row after the last of each episode, shape (episodes,)."""
    last: Rows
    """For every frame that teaches, the last row of its run; -1 for the others, shape (n,)."""
    rows: Mapping[str, Rows]
    """Group -> rows that may start a training sample, at least one each."""
    weights: Mapping[str, float]
    """Group -> share of each batch; the shares add up to 1."""
    held_out_rows: Rows
    """Rows that may start a sample of the validation split, in order; may be empty."""

    @classmethod
    def load(cls, folder: Path, consents: Consents = NO_CONSENTS) -> Self:
        """Read a version folder without lerobot or torch.

        Args:
            folder: where the version lies.
            consents: the consent records, and the moment of this use.

        Raises:
            ConsentError: the version holds an episode of a person who did not consent, or does not any more.
            DatasetError: the folder is no version, was changed after it was built, lost an episode that was
                forgotten, or is of another robot.
        """
        version = load_version(folder)
        refuse_incomplete(version, folder)
        weights = version.weights
        refuse_others(without_cameras(features_in(folder)), FEATURES, robot="arm", where=folder)
        episodes = read_parquet(folder / EPISODES, ["dataset_from_index", "dataset_to_index", "split", "group",
                                                    "episode_id", "consents"])
        consents.check_needs(needs_in(episodes, folder), folder)
        starts, stops = (to_rows(episodes.column(n), 1)[:, 0] for n in ("dataset_from_index", "dataset_to_index"))
        state, environment, action, intervention = _read(folder)
        teaches, last = teaching(starts, stops, intervention)
        lengths = stops - starts
        train = np.repeat(np.array(episodes.column("split").to_pylist()) == "train", lengths)
        group = np.repeat(np.array(episodes.column("group").to_pylist()), lengths)
        rows = {name: np.flatnonzero(train & teaches & (group == name)) for name in weights}
        return cls(state, environment, action, starts, stops, last, rows, weights, np.flatnonzero(~train & teaches))

    def sample(self, rng: np.random.Generator, batch: int, chunk: int) -> Batch:
        """Draw training samples: the groups by their shares, the frames of a group evenly, with replacement.

        Shares that do not give whole numbers are rounded at random, so that they hold on average for
        every size of batch. Equal generators give equal batches.

        Args:
            rng: the only source of randomness.
            batch: samples to draw.
            chunk: actions a sample, at least 1.
        """
        exact = batch * np.array([self.weights[name] for name in self.rows])
        counts = np.floor(exact + 1e-9).astype(np.intp)
        if rest := batch - int(counts.sum()):
            part = np.maximum(exact - counts, 0)
            counts += rng.multinomial(rest, part / part.sum())
        picks = [rows[rng.integers(rows.size, size=n)] for rows, n in zip(self.rows.values(), counts, strict=True)]
        return self.gather(np.concatenate(picks), chunk)

    def training(self, chunk: int) -> Batch:
        """Every training sample, once and in order."""
        return self.gather(np.sort(np.concatenate(list(self.rows.values()))), chunk)

    def held_out(self, chunk: int) -> Batch:
        """Every sample of the validation split, once and in order; may be empty."""
        return self.gather(self.held_out_rows, chunk)

    def gather(self, rows: Rows, chunk: int) -> Batch:
        """The samples that start at these rows."""
        wanted = rows[:, None] + np.arange(chunk)
        last = self.last[rows][:, None]
        return Batch(self.state.take(rows, axis=0), self.environment.take(rows, axis=0),
                     self.action.take(np.minimum(wanted, last), axis=0), wanted <= last)


def without_cameras(features: Features) -> Features:
    """Features without the skews of cameras, which a version without them does not have."""
    return {name: values for name, values in features.items() if not name.startswith(SKEW)}


def needs_in(episodes: Any, folder: Path) -> dict[str, tuple[str, ...]]:
    """Episode id -> consent records that it rests on."""
    if "consents" not in episodes.column_names:
        raise DatasetError("the version does not say whose consent it rests on", where=folder,
                           mend="it was built by an older Hardcase; build it again: hardcase build")
    columns = (episodes.column(name).to_pylist() for name in ("episode_id", "consents"))
    return {id: tuple(filter(None, text.split(","))) for id, text in zip(*columns, strict=True)}


def _read(folder: Path) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
    names = ("observation.state", "observation.environment_state", "action")
    widths = {**{name: len(FEATURES[name]) for name in names}, INTERVENTION: 1}
    tables: list[Any] = []
    while (path := folder / data_file(len(tables))).exists():
        tables.append(read_parquet(path, [*widths]))
    table = pa.concat_tables(tables)
    state, environment, action, intervention = (to_rows(table.column(n), width) for n, width in widths.items())
    return state, environment, action, intervention


def teaching(starts: Rows, stops: Rows, intervention: NDArray[np.int64]) -> tuple[NDArray[np.bool_], Rows]:
    """Whether each frame teaches, and the last row of the run of teaching frames that it stands in."""
    lengths = stops - starts
    commanded = intervention[:, 0] == 1
    taken_over = np.repeat(np.logical_or.reduceat(commanded, starts), lengths)
    teaches = commanded | ~taken_over
    ends = teaches.copy()  # a run ends where the episode does, or before a frame that does not teach
    ends[:-1] &= ~teaches[1:]
    ends[stops - 1] = teaches[stops - 1]
    last = np.full(teaches.size, -1)
    at = np.flatnonzero(ends)
    last[teaches] = at[np.searchsorted(at, np.flatnonzero(teaches))]
    return teaches, last
