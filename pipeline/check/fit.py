"""Training data against the task that its policy will be judged by, and statistics against the rows they describe."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.check.signals import Subject, Tables
from schemas.contract import Contract, Evaluation
from schemas.finding import Finding

OUTSIDE_SHARE, OUTSIDE_BY = 0.05, 0.1
"""Share of actions that may lie outside the task's range, and how far, in shares of the range: a policy asks for a
little more than the robot gives now and then (2 % of its frames by 5 %), a wrong unit for much more always."""


def evaluation(subject: Subject, contract: Contract) -> Iterator[Finding]:
    """Robot, task, rate, features and range of actions: what a policy learns must be what it will be asked for."""
    task = contract.evaluation
    if task is None:
        return
    for wanted, found, what in _facts(subject, task):
        if wanted is not None and found is not None and wanted != found:
            yield Finding(check="evaluation", what=f"{what} is {found}, the evaluation has {wanted}",
                          where=subject.name, value=float(found) if isinstance(found, float) else None,
                          limit=float(wanted) if isinstance(wanted, float) else None,
                          mend="train on data of the robot and task that is evaluated, or evaluate what was recorded")
    if subject.tables is not None:
        yield from _features(subject, subject.tables, task)
        yield from _actions(subject, subject.tables, task)


def _facts(subject: Subject, task: Evaluation) -> Iterator[tuple[object, object, str]]:
    if subject.tables is not None:
        recipe = subject.tables.manifest.get("recipe", {})
        yield task.robot, subject.tables.info.get("robot_type"), "the robot"
        yield task.control_hz, float(subject.tables.info.get("fps", 0)), "the control rate [Hz]"
        yield task.task, recipe.get("task"), "the task"
        return
    record = subject.recordings[0].metadata.get("episode", {})
    yield task.robot, record.get("robot"), "the robot"
    yield task.control_hz, _number(record.get("control_hz")), "the control rate [Hz]"
    yield task.task, record.get("task"), "the task"


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        return None


def _features(subject: Subject, tables: Tables, task: Evaluation) -> Iterator[Finding]:
    declared: Mapping[str, Any] = tables.info.get("features", {})
    for name, values in task.features.items():
        have = feature_names(declared, name)
        if have is None:
            what = f"feature {name} is missing"
        elif list(have) != list(values):
            what = f"feature {name} holds {_first_difference(have, values)}"
        else:
            continue
        yield Finding(check="evaluation", what=what, where=f"{subject.name} {name}",
                      mend="build the version with the features of the evaluation's environment, in its order")


def feature_names(declared: Mapping[str, Any], name: str) -> tuple[str, ...] | None:
    """Names of a feature's values as info.json gives them (a list, or lerobot's {axis: list}); None if absent."""
    if name not in declared:
        return None
    names = declared[name].get("names")
    if isinstance(names, dict):
        names = next(iter(names.values()), None)  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    width = int(np.prod(declared[name].get("shape") or [1]))
    if isinstance(names, list) and len(names) == width:  # pyright: ignore[reportUnknownArgumentType]
        return tuple(str(n) for n in names)  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    return tuple(f"{name}[{k}]" for k in range(width))


def _first_difference(have: Sequence[str], wanted: Sequence[str]) -> str:
    if len(have) != len(wanted):
        return f"{len(have)} values, the evaluation has {len(wanted)}"
    k = next(k for k, (a, b) in enumerate(zip(have, wanted, strict=True)) if a != b)
    return f"{have[k]!r} at place {k}, the evaluation has {wanted[k]!r}"


def _actions(subject: Subject, tables: Tables, task: Evaluation) -> Iterator[Finding]:
    rows = tables.frames.get(task.action)
    width = len(task.action_low)
    if rows is None or not width or len(task.action_high) != width or rows.shape[1] != width or not len(rows):
        return
    low, high = np.array(task.action_low), np.array(task.action_high)
    slack = OUTSIDE_BY * (high - low)
    outside = ((rows < low - slack) | (rows > high + slack)).mean(axis=0)
    names = feature_names(tables.info.get("features", {}), task.action) or tuple(map(str, range(width)))
    for k in np.flatnonzero(outside > OUTSIDE_SHARE).tolist():
        yield Finding(check="evaluation", what=f"{outside[k]:.0%} of {names[k]} lie outside {low[k]:.3g} to "
                      f"{high[k]:.3g}, which the evaluation takes", where=f"{subject.name} {task.action} {names[k]}",
                      value=float(np.abs(rows[:, k]).max()), limit=float(high[k]),
                      mend="look at the action's unit and meaning (absolute or relative); it would be clipped")


def statistics(subject: Subject, contract: Contract) -> Iterator[Finding]:
    """meta/stats.json against the rows: a normaliser built on wrong numbers shifts every observation."""
    tables = subject.tables
    if tables is None:
        return
    for name, measures in tables.stats.items():
        rows = tables.frames.get(name)
        if rows is None or not len(rows) or rows.dtype.kind not in "fiu":
            continue
        values = rows.astype(np.float64)
        spread = np.maximum(values.std(axis=0), 1e-6 + 1e-6 * np.abs(values).max(axis=0))
        for measure, exact in (("mean", values.mean(axis=0)), ("std", values.std(axis=0)), ("min", values.min(axis=0)),
                               ("max", values.max(axis=0))):
            told = np.asarray(measures.get(measure, exact), np.float64).reshape(-1)
            if told.shape != exact.shape:
                yield _wrong(subject, name, measure, f"has {told.size} values for {exact.size}", None)
                break
            off = np.abs(told - exact) / spread
            worst = int(off.argmax())
            if not off[worst] <= contract.thresholds.statistics:
                what = f"{measure} of value {worst} is {told[worst]:.4g}, the rows give {exact[worst]:.4g}"
                yield _wrong(subject, name, measure, what, float(off[worst]))
                break
        told_count = np.asarray(measures.get("count", [len(rows)])).reshape(-1)
        if told_count.size and int(told_count[0]) != len(rows):
            yield _wrong(subject, name, "count", f"count is {int(told_count[0])}, there are {len(rows)} rows", None)


def _wrong(subject: Subject, name: str, measure: str, what: str, value: float | None) -> Finding:
    return Finding(check="statistics", what=what, where=f"{subject.name} {name}", value=value,
                   mend="compute the statistics anew from the rows, or build the version again: hardcase build")


def tables(subject: Subject, contract: Contract) -> Iterator[Finding]:
    """A dataset's tables against each other: totals, lengths, numbering, times, and the bytes of our versions."""
    found = subject.tables
    if found is None:
        return
    if found.damage:
        yield _inconsistent(subject, found.damage)
    lengths = np.asarray(found.episodes["length"], np.int64)
    rows = len(next(iter(found.frames.values()))) if found.frames else 0
    if found.info.get("total_frames") != rows or int(lengths.sum()) != rows:
        yield _inconsistent(subject, f"info.json counts {found.info.get('total_frames')} frames, the episodes table "
                            f"{int(lengths.sum())}, the data files hold {rows}")
    elif found.info.get("total_episodes") != len(lengths):
        yield _inconsistent(subject, f"info.json counts {found.info.get('total_episodes')} episodes, the table "
                            f"{len(lengths)}")
    else:
        yield from _numbering(subject, found, lengths)


def _numbering(subject: Subject, found: Tables, lengths: NDArray[np.int64]) -> Iterator[Finding]:
    rows, fps = int(lengths.sum()), float(found.info.get("fps", 1))
    stops = np.cumsum(lengths)
    within = np.arange(rows) - np.repeat(stops - lengths, lengths)
    expected = {"index": np.arange(rows), "episode_index": np.repeat(np.arange(len(lengths)), lengths),
                "frame_index": within, "timestamp": within / fps}
    for name, values in expected.items():
        column = found.frames.get(name)
        if column is None:
            yield _inconsistent(subject, f"column {name} is missing")
            continue
        off = np.abs(column[:, 0].astype(np.float64) - values)
        if (off > 1e-3 / fps * (1 if name == "timestamp" else fps) + 1e-6 * np.abs(values)).any():
            row = int(off.argmax())
            yield _inconsistent(subject, f"{name} of row {row} is {column[row, 0]:g}, should be {values[row]:g}", row)


def _inconsistent(subject: Subject, what: str, row: int | None = None) -> Finding:
    return Finding(check="tables", what=what, where=subject.name, frame=row,
                   mend="build the version again from its recordings: hardcase build")
