"""Fields of a version hidden by a map: a version opened so that nothing of them is read any more."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, scalars, texts, to_arrow, to_rows
from pipeline.footage import FEATURE
from pipeline.lerobot_view.opened import Opened
from pipeline.redaction.names import ACTOR, TASK, is_feature, is_text, names_in
from schemas.redaction import WORD, FieldRule, RedactionMap

NOBODY = frozenset({"expert", "policy", "oracle"})
"""Actors that are programs."""


@dataclass
class Texts:
    """What texts become, the same in every source of a version; and which texts those were."""

    map: RedactionMap
    numbers: dict[str, dict[str, str]] = field(default_factory=dict[str, dict[str, str]])
    """Field -> text -> its pseudonym."""
    hidden: dict[str, set[str]] = field(default_factory=dict[str, set[str]])
    """Field -> texts that were taken out."""
    stay: dict[str, set[str]] = field(default_factory=dict[str, set[str]])
    """Field -> texts of episodes that the rule spares."""

    def new(self, name: str, text: str, episode: str) -> str:
        """What a text of a field becomes in an episode."""
        rule = self.map.fields.get(name)
        if rule is None or (name == ACTOR and text in NOBODY):
            return text
        if rule.episodes and episode not in rule.episodes:
            self.stay.setdefault(name, set()).add(text)
            return text
        self.hidden.setdefault(name, set()).add(text)
        if rule.do != "pseudonym":
            return str(rule.to) if rule.do == "replace" else WORD
        known = self.numbers.setdefault(name, {})
        return known.setdefault(text, f"{rule.to or name}-{len(known) + 1}")

    def originals(self) -> Mapping[str, set[str]]:
        """Field -> texts that must not be found any more; one that another episode rightly keeps is not among them."""
        return {name: found - self.stay.get(name, set()) for name, found in self.hidden.items()}


def redacted(opened: Opened, map: RedactionMap, words: Texts) -> Opened:
    """The version as it is after redaction of its fields and removal of its cameras; no file is touched.

    Args:
        opened: the version as it lies there.
        map: what is hidden; its names were looked through by `refuse_unknown`.
        words: kept from one source of a derivation to the next.
    """
    rules = {n: r for n, r in map.fields.items() if is_feature(opened, n)}
    gone = [FEATURE + name for name, rule in map.cameras.items() if rule.remove]
    episodes, tasks = _episodes(opened, map, words, gone)
    rows = _Rows(opened, rules, _task_index(opened, episodes, tasks))
    return replace(opened, info=_info(opened, rules, gone), episodes=episodes, tasks=tasks, rewrite=rows,
                   rewritten=rows.files(), _files={})


def _episodes(opened: Opened, map: RedactionMap, words: Texts, cameras: Sequence[str]) -> tuple[Any, tuple[str, ...]]:
    """The episodes table, and the tasks: those that were there, then those that are put in their place."""
    table, ids = opened.episodes, opened.ids
    columns: dict[str, Any] = dict(zip(table.column_names, table.columns, strict=True))
    tasks: list[list[str]] = [list(t or ()) for t in opened.texts("tasks")]
    if TASK in map.fields:
        tasks = [[words.new(TASK, t, id) for t in its] for id, its in zip(ids, tasks, strict=True)]
        offsets = np.cumsum([0, *(len(its) for its in tasks)]).astype(np.int32)
        flat = texts([t for its in tasks for t in its])
        columns["tasks"] = pa.ListArray.from_arrays(scalars(offsets), flat).cast(columns["tasks"].type)
    if ACTOR in map.fields:
        columns["segments"] = texts([_segments(str(text), id, words)
                                     for id, text in zip(ids, opened.texts("segments"), strict=True)])
    for name, rule in map.fields.items():
        if is_feature(opened, name):
            if rule.do == "remove" and not rule.values:
                columns = {n: c for n, c in columns.items() if not n.startswith(f"stats/{name}/")}
        elif name not in (TASK, ACTOR):
            _own(columns, opened, name, rule, words)
    for feature in cameras:
        out = f"videos/{feature}/", f"stats/{feature}/"
        columns = {n: c for n, c in columns.items()
                   if not n.startswith(out) and n != f"repeated.{feature.removeprefix(FEATURE)}"}
    return pa.table(columns), tuple(dict.fromkeys((*opened.tasks, *(t for its in tasks for t in its))))


def _segments(text: str, id: str, words: Texts) -> str:
    parts: list[tuple[str, int, int, str]] = json.loads(text)
    return json.dumps([[kind, a, b, actor if kind == "autonomous" else words.new(ACTOR, actor, id)]
                       for kind, a, b, actor in parts], separators=(",", ":"))


def _own(columns: dict[str, Any], opened: Opened, name: str, rule: FieldRule, words: Texts) -> None:
    """A column of the episodes table that is ours or that nobody knows."""
    values: list[Any] = opened.texts(name)
    if is_text(opened, name):
        new = [None if v is None else words.new(name, str(v), id) for id, v in zip(opened.ids, values, strict=True)]
        columns[name] = texts(new)
    else:
        put = rule.to if rule.do == "replace" else 0
        columns[name] = scalars(np.array([put if not rule.episodes or id in rule.episodes else (v or 0)
                                          for id, v in zip(opened.ids, values, strict=True)],
                                         columns[name].type.to_pandas_dtype()))
    if rule.do == "remove":
        del columns[name]


def _task_index(opened: Opened, episodes: Any, tasks: Sequence[str]) -> dict[int, NDArray[np.int64]]:
    """Episode whose task is another now -> its old task_index -> the new one."""
    place, found = {t: k for k, t in enumerate(tasks)}, dict[int, NDArray[np.int64]]()
    for k, (old, new) in enumerate(zip(opened.texts("tasks"), episodes.column("tasks").to_pylist(), strict=True)):
        if list(old or ()) != new:
            index = np.arange(len(opened.tasks))
            for a, b in zip(old or (), new, strict=True):
                index[opened.tasks.index(a)] = place[b]
            found[k] = index
    return found


def _info(opened: Opened, rules: Mapping[str, FieldRule], cameras: Sequence[str]) -> dict[str, Any]:
    features: dict[str, Any] = {n: f for n, f in opened.info["features"].items() if n not in cameras}
    for name, rule in rules.items():
        if rule.do == "remove" and (left := _left(opened, name, rule)):
            names = [names_in(opened, name)[k] for k in left]
            features[name] = {**features[name], "shape": [len(left)], "names": names}
        elif rule.do == "remove":
            del features[name]
    films = any(f["dtype"] == "video" for f in features.values())
    return {**opened.info, "features": features, "video_path": opened.info["video_path"] if films else None}


def _left(opened: Opened, name: str, rule: FieldRule) -> list[int]:
    """Which values of a feature stay where some are removed."""
    return [k for k, n in enumerate(names_in(opened, name)) if n not in rule.values] if rule.values else []


@dataclass(frozen=True)
class _Rows:
    """Changes the tables of a version's data files as they are read."""

    opened: Opened
    rules: Mapping[str, FieldRule]
    task_index: Mapping[int, NDArray[np.int64]]

    def files(self) -> frozenset[int]:
        """Numbers of the data files that it changes."""
        numbers: set[int] = set(self.opened.files[list(self.task_index)].tolist())
        for rule in self.rules.values():
            numbers |= set(self.opened.files[self._chosen(rule)].tolist())
        return frozenset(numbers)

    def __call__(self, number: int, table: Any) -> Any:
        if number not in self.files():
            return table
        opened, first = self.opened, self.opened.first_row(number)

        def rows(k: int) -> slice:
            return slice(int(opened.starts[k]) - first, int(opened.starts[k] + opened.lengths[k]) - first)

        here = [int(k) for k in np.flatnonzero(opened.files == number)]
        for name, rule in self.rules.items():
            chosen = self._chosen(rule)
            table = _changed(table, opened, name, rule, [rows(k) for k in here if chosen[k]])
        index = to_rows(table.column("task_index"), 1)[:, 0].copy()
        for k in (k for k in here if k in self.task_index):
            index[rows(k)] = self.task_index[k][index[rows(k)]]
        return table.set_column(table.column_names.index("task_index"), "task_index", scalars(index))

    def _chosen(self, rule: FieldRule) -> NDArray[np.bool_]:
        if not rule.episodes:
            return np.ones(len(self.opened), np.bool_)
        return np.array([id in rule.episodes for id in self.opened.ids], np.bool_)


def _changed(table: Any, opened: Opened, name: str, rule: FieldRule, rows: Sequence[slice]) -> Any:
    place = table.column_names.index(name)
    if rule.do == "remove" and not rule.values:
        return table.remove_column(place)
    values = to_rows(table.column(name), opened.widths[name]).copy()
    if rule.do == "remove":
        values = values[:, _left(opened, name, rule)]
    else:
        known = names_in(opened, name)
        which = [known.index(v) for v in rule.values] if rule.values else slice(None)
        for part in rows:
            values[part, which] = rule.to if rule.do == "replace" else 0
    return table.set_column(place, name, to_arrow(values))
