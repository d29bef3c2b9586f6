"""Faults of datasets: rows that are wrong, there twice, or on both sides of the split; tables that do not fit."""

import numpy as np

from pipeline.selftest.dataset import Dataset

type Rng = np.random.Generator

STATE, ENVIRONMENT, ACTION, TARGET = ("observation.state", "observation.environment_state", "action", "action.joint")
NUMBERS = (STATE, ENVIRONMENT, ACTION, TARGET)
LAG = 8
"""Frames; 0.4 s at 20 Hz."""
MOTION = 4
"""Values of an action that move the tool; the fifth is the finger opening asked for [m]."""
ARM = 6
"""Joints that turn come first in every row of joints."""
COMMANDED = slice(11, 14)
"""Commanded position of the tool in observation.state [m]; see pipeline.frames.STATE."""


def nan(data: Dataset, rng: Rng) -> None:
    """One value of one row is NaN."""
    rows = data.rows[STATE].copy()
    rows[rng.integers(len(rows)), rng.integers(rows.shape[1])] = np.nan
    data.rows[STATE] = rows


def late_actions(data: Dataset, rng: Rng) -> None:
    """Every row holds the action of 8 rows before."""
    for name in (ACTION, TARGET):
        rows = data.rows[name].copy()
        for part in data.parts():
            rows[part] = np.concatenate([np.repeat(rows[part][:1], LAG, axis=0), rows[part][:-LAG]])
        data.rows[name] = rows
    data.measure()


def turned_actions(data: Dataset, rng: Rng) -> None:
    """Every motion of one episode the other way round."""
    part, rows = data.parts()[0], data.rows[ACTION].copy()
    rows[part, :MOTION] *= -1
    data.rows[ACTION] = rows
    data.measure()


def shuffled_actions(data: Dataset, rng: Rng) -> None:
    """The actions of one episode in random order."""
    part, rows = data.parts()[0], data.rows[ACTION].copy()
    rows[part] = rng.permutation(rows[part])
    data.rows[ACTION] = rows
    data.measure()


def degrees(data: Dataset, rng: Rng) -> None:
    """The measured joints are in degrees."""
    rows = data.rows[STATE].copy()
    rows[:, :ARM] = np.degrees(rows[:, :ARM])
    data.rows[STATE] = rows
    data.measure()


def absolute_actions(data: Dataset, rng: Rng) -> None:
    """Actions are positions in the world, not steps from the last commanded one."""
    rows = data.rows[ACTION].copy()
    rows[:, :3] += data.rows[STATE][:, COMMANDED]
    data.rows[ACTION] = rows
    data.measure()


def duplicate(data: Dataset, rng: Rng) -> None:
    """One training episode is another one once more, under its own number and lineage."""
    _overlay(data, *_two_of_training(data, rng))


def _two_of_training(data: Dataset, rng: Rng) -> tuple[int, int]:
    train = [k for k, split in enumerate(data.column("split")) if split == "train"]
    one, other = (train[int(k)] for k in rng.choice(len(train), 2, replace=False))
    return one, other


def leak_by_content(data: Dataset, rng: Rng) -> None:
    """A held-out episode is a training episode once more, under its own number and lineage."""
    splits = data.column("split")
    train, held = ([k for k, s in enumerate(splits) if s == name] for name in ("train", "held_out"))
    _overlay(data, int(rng.choice(train)), int(rng.choice(held)))


def _overlay(data: Dataset, source: int, target: int, *, late: int = 0) -> None:
    """Lay one episode, from its row `late` on, over another one, as far as both go."""
    one, other = data.parts()[source], data.parts()[target]
    n = min(one.stop - one.start - late, other.stop - other.start)
    for name in NUMBERS:
        rows = data.rows[name].copy()
        rows[other.start:other.start + n] = rows[one.start + late:one.start + late + n]
        data.rows[name] = rows
    data.measure()


def leak_by_descent(data: Dataset, rng: Rng) -> None:
    """A variant of a training episode is held out: split by episodes, not by lineage."""
    splits, lineages = data.column("split"), data.column("lineage")
    train, held = ([k for k, s in enumerate(splits) if s == name] for name in ("train", "held_out"))
    lineages[int(rng.choice(held))] = lineages[int(rng.choice(train))]
    data.set_texts("lineage", lineages)


def false_failure(data: Dataset, rng: Rng) -> None:
    """The table calls a success a failure."""
    outcomes = data.column("outcome")
    outcomes[int(rng.integers(len(outcomes)))] = "failure"
    data.set_texts("outcome", outcomes)


def old_statistics(data: Dataset, rng: Rng) -> None:
    """The statistics were taken before the last third of the rows was added."""
    whole = data.rows
    data.rows = {name: rows[:len(rows) * 2 // 3] for name, rows in whole.items()}
    data.measure(each=False)
    data.rows = whole


def missing_row(data: Dataset, rng: Rng) -> None:
    """One row is missing; the tables count it."""
    lost = int(rng.integers(len(data.rows["index"])))
    data.rows = {name: np.delete(rows, lost, axis=0) for name, rows in data.rows.items()}


def wrong_times(data: Dataset, rng: Rng) -> None:
    """Times count at 30 frames a second, the table says 20."""
    data.rows["timestamp"] = (data.rows["frame_index"] / 30).astype(np.float32)
    data.measure()


def other_robot(data: Dataset, rng: Rng) -> None:
    """Of another robot than the policy will drive."""
    data.info["robot_type"] = "arm-7"


def other_rate(data: Dataset, rng: Rng) -> None:
    """At 25 rows a second, all tables agreeing; the policy will be asked 20 times a second."""
    data.info["fps"] = 25
    data.rows["timestamp"] = (data.rows["frame_index"] / 25).astype(np.float32)
    data.measure()


def other_order(data: Dataset, rng: Rng) -> None:
    """The gripper is the first value of the action, not the last."""
    names = data.info["features"][ACTION]["names"]
    data.info["features"][ACTION]["names"] = [names[-1], *names[:-1]]
    data.rows[ACTION] = np.roll(data.rows[ACTION], 1, axis=1)
    data.measure()


def near_duplicate(data: Dataset, rng: Rng) -> None:
    """One training episode is another one through a text file with four digits."""
    source, target = _two_of_training(data, rng)
    one, other = data.parts()[source], data.parts()[target]
    for name, rows in data.rows.items():
        laid = rows[one].round(4) if name in NUMBERS else rows[one]
        kept = rows[other][:1] if name == "episode_index" else laid
        data.rows[name] = np.concatenate([rows[:other.start], np.broadcast_to(kept, laid.shape), rows[other.stop:]])
    data.count(target, one.stop - one.start)


def late_duplicate(data: Dataset, rng: Rng) -> None:
    """One training episode is another one without its first 0.5 s."""
    one, other = _two_of_training(data, rng)
    _overlay(data, one, other, late=10)


def hole(data: Dataset, rng: Rng) -> None:
    """Ten rows of one episode were left out, and every total says so; only their numbers and times have a hole."""
    part = data.parts()[1]
    start = part.start + (part.stop - part.start) // 2
    data.rows = {name: np.delete(rows, slice(start, start + 10), axis=0) for name, rows in data.rows.items()}
    data.count(1, part.stop - part.start - 10)


def uneven_times(data: Dataset, rng: Rng) -> None:
    """Times are those of a clock that was late by up to 20 ms, not those of the control tick."""
    late = rng.uniform(0, 0.02, data.rows["timestamp"].shape)
    data.rows["timestamp"] = (data.rows["timestamp"] + late).astype(np.float32)
    data.measure()


def doubled_row(data: Dataset, rng: Rng) -> None:
    """One row is there twice; every total counts it."""
    row = _inside_second(data, rng)
    data.rows = {name: np.insert(rows, row, rows[row], axis=0) for name, rows in data.rows.items()}
    data.count(1, data.column("length")[1] + 1)


def exchanged_rows(data: Dataset, rng: Rng) -> None:
    """Two rows that follow each other are in the wrong order, their numbers with them."""
    row = _inside_second(data, rng)
    order = np.arange(len(data.rows["index"]))
    order[row:row + 2] = row + 1, row
    data.rows = {name: rows[order] for name, rows in data.rows.items()}


def _inside_second(data: Dataset, rng: Rng) -> int:
    """A row of the second episode, neither its first nor its last."""
    lengths: list[int] = data.column("length")
    return lengths[0] + int(rng.integers(1, lengths[1] - 1))
