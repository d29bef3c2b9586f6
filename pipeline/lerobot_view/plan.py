"""The plan of a derived version: everything that its tables will say of each episode, before anything is written."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.lerobot_view.draft import Draft
from pipeline.lerobot_view.reweighing import Weighed, weighed

type Whole = NDArray[np.int64]


@dataclass(frozen=True)
class Plan:
    """What each episode of a draft will be in its version; lists and arrays have a value for each."""

    draft: Draft
    ids: list[str]
    tasks: list[str]
    """In the order of task_index; those that nothing uses any more are gone."""
    task_index: tuple[Whole, ...]
    """For each source, its task_index -> the new one; -1 for tasks that are gone."""
    outcome: list[str]
    trigger: list[str | None]
    family: list[str | None]
    segments: list[str]
    lineage: list[str]
    split: list[str]
    weighed: Weighed
    firsts: Whole
    """Global row of the first frame."""
    head: int
    """Episodes at the beginning whose data files are the parent's."""

    @property
    def lengths(self) -> Whole:
        """Frames of each episode."""
        return self.draft.lengths

    @property
    def frames(self) -> int:
        """Of all episodes."""
        return int(self.lengths.sum())

    @property
    def same_frames(self) -> bool:
        """Whether every frame of the parent is still in its place, and no other has come."""
        parent = self.draft.parent
        return self.head == len(self.ids) == len(parent) and parent.rewrite is None

    @property
    def trimmed(self) -> Whole:
        """Places of the episodes of which only a part stays."""
        whole = np.empty(len(self.ids), np.int64)
        for s, source in enumerate(self.draft.sources):
            here = self.draft.source == s
            whole[here] = source.lengths[self.draft.row[here]]
        return np.flatnonzero(self.lengths != whole)


def planned(draft: Draft) -> Plan:
    """What the tables of a drafted version will say.

    Raises:
        DatasetError: nothing is left to train on, or a trimmed episode has lost all that it taught.
    """
    ids, count = draft.ids, len(draft)
    outcome, trigger, family = (draft.gathered(c) for c in ("outcome", "trigger", "family"))
    for k, id in enumerate(ids) if draft.labels else ():
        if id in draft.labels:
            same = draft.labels[id] == outcome[k]
            outcome[k] = draft.labels[id]
            trigger[k], family[k] = (trigger[k], family[k]) if same else (None, None)
    segments = _segments(draft, ids)
    lineage = draft.gathered("lineage")
    split = _sides(draft, lineage)
    groups = [draft.groups.get(id, g) for id, g in zip(ids, draft.gathered("group"), strict=True)]
    factors = np.array([draft.factors.get(id, 1.0) for id in ids]) if draft.factors else np.ones(count)
    weights = weighed(groups, np.array([s == "train" for s in split]), _taught(segments, draft.lengths), factors,
                      draft.shares)
    tasks, index = _tasks(draft)
    lengths = draft.lengths
    return Plan(draft, ids, tasks, index, outcome, trigger, family, segments, lineage, split, weights,
                np.cumsum(lengths) - lengths, _head(draft, index[0]))


def _segments(draft: Draft, ids: Sequence[str]) -> list[str]:
    """Who commanded which frames, as JSON; cut where the episode is."""
    segments: list[str] = draft.gathered("segments")
    for k in map(int, np.flatnonzero((draft.start > 0) | (draft.stop < _whole(draft)))):
        start, stop = int(draft.start[k]), int(draft.stop[k])
        parts: list[tuple[str, int, int, str]] = json.loads(segments[k])
        left = [[kind, max(a, start) - start, min(b, stop) - start, actor] for kind, a, b, actor in parts
                if a < stop and b > start]
        if "intervention" in {p[0] for p in parts} - {p[0] for p in left}:
            raise DatasetError(f"frames {start} to {stop} hold nothing of the intervention", where=f"episode {ids[k]}",
                               mend="trim around the intervention, or drop the episode: what led to a failure must "
                                    "not teach")
        segments[k] = json.dumps(left, separators=(",", ":"))
    return segments


def _whole(draft: Draft) -> Whole:
    return np.concatenate([s.lengths for s in draft.sources])[draft.row + _before(draft)[draft.source]]


def _before(draft: Draft) -> Whole:
    """Episodes of the sources before each source."""
    return np.cumsum([0, *(len(s) for s in draft.sources[:-1])])


def _taught(segments: Sequence[str], lengths: Whole) -> Whole:
    """Frames that a policy learns from: those of the intervention if there was one, else all."""
    taught = lengths.copy()
    for k, text in enumerate(segments):
        if '"intervention"' in text:
            parts: list[tuple[str, int, int, str]] = json.loads(text)
            taught[k] = sum(b - a for kind, a, b, _ in parts if kind == "intervention")
    return taught


def _sides(draft: Draft, lineage: Sequence[str]) -> list[str]:
    """Train or held_out. What the parent decided of a lineage stands, also for episodes that are added."""
    sides: list[str] = draft.gathered("split")
    if len(draft.sources) > 1:
        decided: dict[str, str] = {}
        for source in draft.sources:
            for side in ("held_out", "train"):
                for one in source.manifest["lineages"][side]:
                    decided.setdefault(one, side)
        sides = [decided.get(one, side) for one, side in zip(lineage, sides, strict=True)]
    return sides


def _tasks(draft: Draft) -> tuple[list[str], tuple[Whole, ...]]:
    """The tasks that are used, and for each source where its tasks went."""
    used = {task for tasks in draft.gathered("tasks") for task in tasks}
    tasks = [t for t in dict.fromkeys(t for source in draft.sources for t in source.tasks) if t in used]
    place = {task: k for k, task in enumerate(tasks)}
    return tasks, tuple(np.array([place.get(t, -1) for t in source.tasks], np.int64) for source in draft.sources)


def _head(draft: Draft, task_index: Whole) -> int:
    """How many episodes stand where they stood in the parent, frame by frame, and fill whole data files."""
    parent, count = draft.parent, min(len(draft), len(draft.parent))
    same = ((draft.source[:count] == 0) & (draft.row[:count] == np.arange(count))
            & (draft.start[:count] == 0) & (draft.stop[:count] == parent.lengths[:count]))
    if (moved := np.flatnonzero((task_index != np.arange(len(task_index))) & (task_index >= 0))).size:
        gone: set[Any] = {parent.tasks[k] for k in moved}
        same &= np.array([not gone & set(tasks or ()) for tasks in parent.texts("tasks")[:count]])
    if parent.rewritten:
        same &= ~np.isin(parent.files[:count], list(parent.rewritten))
    until = int(np.argmin(same)) if not same.all() else count
    ends = np.flatnonzero(np.diff(parent.files, append=-1))  # last episode of each data file
    return int(max((e + 1 for e in ends.tolist() if e < until), default=0))
