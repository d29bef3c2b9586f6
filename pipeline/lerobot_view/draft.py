"""A version in the making: which episodes of which versions, cut, labelled and weighted how. No file is touched."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.lerobot_view.opened import Opened
from schemas.edits import Add, Drop, Edit, Relabel, Reweight, Trim

type Places = NDArray[np.int64]


@dataclass(frozen=True)
class Draft:
    """Episodes in their future order; every array has a value for each of them."""

    sources: tuple[Opened, ...]
    """The parent, then versions that episodes were added from."""
    source: Places
    """Which of the sources an episode lies in."""
    row: Places
    """Its place in the episodes table of its source."""
    start: Places
    """First frame that stays, counted from the episode's first in its source."""
    stop: Places
    """Frame after the last that stays."""
    shares: Mapping[str, float]
    """Group -> share of each batch; they need not add up to 1 yet."""
    labels: Mapping[str, str] = field(default_factory=dict[str, str])
    """Episode -> outcome that a person gave it."""
    factors: Mapping[str, float] = field(default_factory=dict[str, float])
    """Episode -> how many times as often it is drawn, beside others of its group."""
    groups: Mapping[str, str] = field(default_factory=dict[str, str])
    """Episode -> group, where it is not that of its source."""

    @classmethod
    def of(cls, parent: Opened) -> Self:
        """The parent as it is."""
        count = len(parent)
        zeros = np.zeros(count, np.int64)
        return cls((parent,), zeros, np.arange(count), zeros, parent.lengths, dict(parent.version.weights))

    def __len__(self) -> int:
        return len(self.row)

    @property
    def ids(self) -> list[str]:
        """Id of every episode, in order."""
        return self.gathered("episode_id")

    @property
    def lengths(self) -> Places:
        """Frames of every episode."""
        return self.stop - self.start

    def walk(self, first: int = 0) -> Iterator[tuple[Opened, int, int, int]]:
        """Source, its number, row in it, and first frame that stays, of every episode from the `first` on."""
        for s, k, start in zip(*(map(int, a[first:]) for a in (self.source, self.row, self.start)), strict=True):
            yield self.sources[s], s, k, start

    def gathered(self, column: str) -> list[Any]:
        """A column of the sources' episodes tables, in the order of the draft."""
        values = [source.texts(column) for source in self.sources]
        if len(values) == 1:
            return [values[0][k] for k in self.row.tolist()]
        return [values[s][k] for s, k in zip(self.source.tolist(), self.row.tolist(), strict=True)]

    def place(self, episodes: Iterable[str]) -> Places:
        """Where these episodes stand, in the order that they are named in.

        Raises:
            DatasetError: one is not there; names those that look like it.
        """
        at = {id: k for k, id in enumerate(self.ids)}
        wanted = list(episodes)
        for id in wanted:
            if id not in at:
                near = get_close_matches(id, list(at)[:5000], n=3, cutoff=0.5) or list(at)[:3]
                raise DatasetError(f"episode {id} is not in the version", where=f"version {self.parent.version.id}",
                                   mend=f"use one that is, such as {', '.join(near)}")
        return np.array([at[id] for id in wanted], np.int64)

    @property
    def parent(self) -> Opened:
        """The version that this one is derived from."""
        return self.sources[0]

    def kept(self, mask: NDArray[np.bool_]) -> "Draft":
        """The draft with these episodes alone, their order kept."""
        return replace(self, source=self.source[mask], row=self.row[mask], start=self.start[mask],
                       stop=self.stop[mask])


def _drop(draft: Draft, edit: Drop, known: Mapping[str, Opened]) -> Draft:
    mask = np.ones(len(draft), np.bool_)
    mask[draft.place(edit.episodes)] = False
    return draft.kept(mask)


def _add(draft: Draft, edit: Add, known: Mapping[str, Opened]) -> Draft:
    other = known[edit.version]
    here, there = set(draft.ids), {id: k for k, id in enumerate(other.ids)}
    for id in edit.episodes:
        if id in here or id not in there:
            raise DatasetError(f"episode {id} is {'there already' if id in here else 'not in the version'}",
                               where=f"--add {edit.version}",
                               mend="leave it out" if id in here else f"see hardcase datasets {edit.version}")
    rows = np.array([there[id] for id in edit.episodes], np.int64)
    groups, shares = _joined(draft, edit, other, rows)
    return replace(
        draft, sources=(*draft.sources, other), shares=shares, groups={**draft.groups, **groups},
        source=np.append(draft.source, np.full(len(rows), len(draft.sources))), row=np.append(draft.row, rows),
        start=np.append(draft.start, np.zeros(len(rows), np.int64)), stop=np.append(draft.stop, other.lengths[rows]))


def _joined(draft: Draft, edit: Add, other: Opened, rows: Places) -> tuple[dict[str, str], dict[str, float]]:
    """Groups of added episodes where they change, and the shares of all groups: a share of their own, or by name."""
    if edit.share is None:
        return {}, {**other.version.weights, **draft.shares}
    name = free_name(other.version.recipe, draft.shares)
    rest = sum(draft.shares.values())
    shares = {g: s / rest * (1 - edit.share) for g, s in draft.shares.items()}
    return dict.fromkeys(edit.episodes, name), {**shares, name: edit.share}


def free_name(name: str, taken: Iterable[str]) -> str:
    """The name, or the name with a number where it is taken."""
    names, k, found = set(taken), 2, name
    while found in names:
        found, k = f"{name} {k}", k + 1
    return found


def _reweight(draft: Draft, edit: Reweight, known: Mapping[str, Opened]) -> Draft:
    draft.place(edit.episodes)
    return replace(draft, factors={**draft.factors,
                                   **{id: draft.factors.get(id, 1.0) * edit.factor for id in edit.episodes}})


def _trim(draft: Draft, edit: Trim, known: Mapping[str, Opened]) -> Draft:
    (k,) = draft.place([edit.episode])
    if edit.stop > draft.lengths[k]:
        raise DatasetError(f"episode {edit.episode} has {draft.lengths[k]} frames, {edit.stop} were asked for",
                           where=f"--trim {edit.episode}:{edit.start}:{edit.stop}",
                           mend=f"use --trim {edit.episode}:{edit.start}:{draft.lengths[k]} at most")
    start, stop = draft.start.copy(), draft.stop.copy()
    start[k], stop[k] = draft.start[k] + edit.start, draft.start[k] + edit.stop
    return replace(draft, start=start, stop=stop)


def _relabel(draft: Draft, edit: Relabel, known: Mapping[str, Opened]) -> Draft:
    draft.place([edit.episode])
    return replace(draft, labels={**draft.labels, edit.episode: edit.outcome})


type Apply = Callable[[Draft, Any, Mapping[str, Opened]], Draft]

APPLY: Mapping[type[Any], Apply] = MappingProxyType({
    Drop: _drop, Add: _add, Reweight: _reweight, Trim: _trim, Relabel: _relabel})
"""What each kind of edit does to a draft. Add one: a model in schemas/edits.py, a function and an entry here."""


def drafted(parent: Opened, edits: Sequence[Edit], known: Mapping[str, Opened]) -> Draft:
    """The parent after all edits, one after the other.

    Args:
        parent: what is edited.
        edits: in the order in which they count.
        known: the versions that Add edits name, by id.

    Raises:
        DatasetError: an edit asks for what is not there, or nothing is left.
    """
    draft = Draft.of(parent)
    for edit in edits:
        draft = APPLY[type(edit)](draft, edit, known)
        if not len(draft):
            raise DatasetError("no episode is left", where=f"version {parent.version.id}",
                               mend="keep at least one episode that is not held out")
    return draft
