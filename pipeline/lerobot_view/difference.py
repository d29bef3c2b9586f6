"""What differs between two versions: episodes, rows, weights, tasks, features and statistics."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, to_rows
from pipeline.lerobot_view.filmed import clips_in
from pipeline.lerobot_view.layout import BOOKKEEPING, STATS, data_file
from pipeline.lerobot_view.opened import Opened

TOLD = ("outcome", "family", "trigger", "split", "group", "segments", "blob", "consents", "tasks", "lineage")
"""Columns of the episodes table that are compared as they are."""


@dataclass(frozen=True, slots=True)
class Difference:
    """From a first version to a second."""

    removed: tuple[str, ...]
    """Episodes that only the first has, in its order."""
    added: tuple[str, ...]
    """Episodes that only the second has."""
    changed: Mapping[str, Mapping[str, tuple[object, object]]]
    """Episode that both have -> what differs -> (first, second); `frames` counts them, `rows` names features whose
    values differ, `pictures` cameras that show others, `weight` is the chance that a sample comes from it."""
    moved: int
    """Episodes that both have, at another episode_index."""
    features: Mapping[str, tuple[object, object]]
    """Feature -> what each says of it; None where one lacks it."""
    statistics: Mapping[str, Mapping[str, float]]
    """Feature -> measure -> largest difference of a value, in the feature's own unit."""

    @property
    def nothing(self) -> bool:
        """Whether both hold the same."""
        return not (self.removed or self.added or self.changed or self.moved or self.features or self.statistics)


def difference(first: Opened, second: Opened) -> Difference:
    """Compare two versions; data files that both share are not read.

    Raises:
        DatasetError: a data file of one of them is missing or was changed.
    """
    here = {id: k for k, id in enumerate(first.ids)}
    there = {id: k for k, id in enumerate(second.ids)}
    both = [id for id in first.ids if id in there]
    mine, theirs = first.info["features"], second.info["features"]
    features = {name: (mine.get(name), theirs.get(name)) for name in dict.fromkeys((*mine, *theirs))
                if mine.get(name) != theirs.get(name)}
    return Difference(
        tuple(id for id in first.ids if id not in there), tuple(id for id in second.ids if id not in here),
        _changed(first, second, both, here, there), sum(here[id] != there[id] for id in both), features,
        _statistics(first, second))


def _changed(first: Opened, second: Opened, both: list[str], here: Mapping[str, int],
             there: Mapping[str, int]) -> dict[str, dict[str, tuple[object, object]]]:
    columns = {name: (first.texts(name), second.texts(name)) for name in TOLD}
    weights = first.asked("weight"), second.asked("weight")
    shared = {n for n in set(map(int, first.files)) & set(map(int, second.files)) if _same_file(first, second, n)}
    found: dict[str, dict[str, tuple[object, object]]] = {}
    films = [{key: clip.key for key, clip in clips_in(o.folder).items()} for o in (first, second)]
    cameras = sorted({camera for of in films for _, camera in of})
    for id in both:
        j, k = here[id], there[id]
        of: dict[str, tuple[object, object]] = {
            name: (a[j], b[k]) for name, (a, b) in columns.items() if a[j] != b[k]}
        if not np.isclose(weights[0][j], weights[1][k], rtol=1e-9, atol=0):
            of["weight"] = float(weights[0][j]), float(weights[1][k])
        if first.lengths[j] != second.lengths[k]:
            of["frames"] = int(first.lengths[j]), int(second.lengths[k])
        elif not (j == k and int(first.files[j]) == int(second.files[k]) in shared) and (
                names := _rows_differ(first, second, j, k)):
            of["rows"] = ", ".join(names), ", ".join(names)
        if first.lengths[j] == second.lengths[k] and (
                seen := [c for c in cameras if len({f[id, c] for f in films if (id, c) in f}) > 1]):
            of["pictures"] = ", ".join(seen), ", ".join(seen)
        if of:
            found[id] = of
    return found


def _same_file(first: Opened, second: Opened, number: int) -> bool:
    name = data_file(number)
    return name in first.hashes and first.hashes[name] == second.hashes.get(name)


def _rows_differ(first: Opened, second: Opened, j: int, k: int) -> list[str]:
    """Features that both have and whose values differ in an episode, bit for bit."""
    one, two = _frames(first, j), _frames(second, k)
    names = [n for n in one.column_names if n in two.column_names and n not in BOOKKEEPING]
    pairs = {n: (one.column(n), two.column(n)) for n in names}
    return [n for n, (a, b) in pairs.items() if not a.equals(b) and not _same_bits(a, b)]


def _same_bits(one: Any, two: Any) -> bool:
    """NaN equals NaN here."""
    if one.type != two.type or pa.types.is_string(one.type):
        return False
    a, b = (np.ascontiguousarray(to_rows(c, max(1, getattr(c.type, "list_size", 1)))) for c in (one, two))
    return a.tobytes() == b.tobytes()


def _frames(opened: Opened, k: int) -> Any:
    number = int(opened.files[k])
    return opened.rows(number).slice(int(opened.starts[k]) - opened.first_row(number), int(opened.lengths[k]))


def _statistics(first: Opened, second: Opened) -> dict[str, dict[str, float]]:
    if first.hashes.get(STATS) == second.hashes.get(STATS):
        return {}
    mine, theirs = (json.loads((o.folder / STATS).read_text(encoding="utf-8")) for o in (first, second))
    found: dict[str, dict[str, float]] = {}
    for name in (n for n in mine if n in theirs and n not in BOOKKEEPING):
        for measure, values in mine[name].items():
            a, b = (np.asarray(v, np.float64) for v in (values, theirs[name].get(measure, np.nan)))
            apart: NDArray[np.float64] = np.abs(a - b) if a.shape == b.shape else np.array([np.inf])
            if measure != "count" and apart.max(initial=0.0) > 0:
                found.setdefault(name, {})[measure] = float(apart.max())
    return found
