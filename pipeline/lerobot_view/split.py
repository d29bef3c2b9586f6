"""Which lineages are held out, and how much each group of episodes weighs."""

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from pipeline.errors import ConfigError, DatasetError
from pipeline.lerobot_view.tables import taught
from schemas.episode import Episode

GROUPS = ("base", "corrections")


@dataclass(frozen=True, slots=True)
class Decided:
    """What earlier versions decided, by ids of episodes and lineages; it is never taken back."""

    held_out: frozenset[str] = frozenset()
    train: frozenset[str] = frozenset()


def lineages(episodes: Iterable[Episode]) -> dict[str, str]:
    """Episode id -> the id at the root of its chain of parents, as far as these episodes tell.

    Two episodes with a common ancestor have one root, even if the ancestor itself is not there.

    Raises:
        DatasetError: a chain of parents runs in a circle.
    """
    up = {e.id: e.lineage for e in episodes}
    roots: dict[str, str] = {}
    for start in up:
        chain, here = [start], start
        while (above := roots.get(here) or up.get(here, here)) != here:
            if above in chain:
                raise DatasetError("an episode is its own ancestor", where=" <- ".join([*chain, above]),
                                   mend="drop the episodes of this circle")
            chain.append(above)
            here = above
        roots |= dict.fromkeys((c for c in chain if c in up), here)
    return roots


def held_out(roots: Mapping[str, str], share: float, decided: Decided) -> frozenset[str]:
    """The lineages of the validation split.

    What an earlier version decided stands; where it held out one of two lineages that turn out to be
    one, all of it is held out. Any other lineage is held out if its hash falls into `share`, which no
    other episode, order or generation can change. Both sides get at least one lineage where there are two.

    Args:
        roots: episode id -> lineage, of the episodes of the version.
        share: expected share of lineages that are held out, 0 to 0.5.
        decided: what the parent version knows.

    Raises:
        DatasetError: nothing is left to train on.
    """
    members: dict[str, set[str]] = {}
    for episode, root in roots.items():
        members.setdefault(root, {root}).add(episode)
    held = {root for root, ids in members.items() if ids & decided.held_out}
    open_roots = sorted((r for r, ids in members.items() if not ids & (decided.held_out | decided.train)), key=_place)
    held |= {root for root in open_roots if _place(root) < share}
    if share > 0 and not held and open_roots and len(members) > 1:
        held = {open_roots[0]}
    if len(held) == len(members) and open_roots:
        held.remove(open_roots[-1])
    if len(held) == len(members):
        raise DatasetError("every lineage of this version is held out", where=f"{len(roots)} episodes",
                           mend="add demonstrations, or start a version without a parent")
    return frozenset(held)


def groups(episodes: Iterable[Episode], known: Mapping[str, Episode]) -> dict[str, str]:
    """Episode id -> base (scripted data of generation 0 and its variants) or corrections.

    Corrections are what a person or the oracle gave and everything made from that. What any later
    generation adds weighs as much, so that a control arm with fresh demonstrations differs in its
    data and in nothing else.

    Args:
        episodes: episodes of the version.
        known: every episode by id, those that the filter left out included.
    """
    def corrected(episode: Episode | None) -> bool:
        while episode is not None and episode.origin not in ("corrected", "oracle"):
            episode = known.get(episode.parent or "")
        return episode is not None

    return {e.id: GROUPS[e.generation > 0 or corrected(e)] for e in episodes}


def shares(wanted: Mapping[str, float], present: Collection[str]) -> dict[str, float]:
    """Share of each training batch by group, over the groups that exist; they add up to 1.

    Raises:
        ConfigError: an unknown group, or one that exists and has no weight.
    """
    if unknown := sorted(set(wanted) - set(GROUPS)):
        raise ConfigError(f"unknown group {unknown[0]!r}", where="recipe: dataset.weights",
                          mend=f"use one of: {', '.join(GROUPS)}")
    if missing := sorted(set(present) - set(wanted)):
        raise ConfigError(f"no weight for the group {missing[0]!r}", where="recipe: dataset.weights",
                          mend=f"add {missing[0]} to dataset.weights, or leave its origins out of dataset.sources")
    total = sum(wanted[g] for g in GROUPS if g in present)
    return {g: wanted[g] / total for g in GROUPS if g in present}


def chances(episodes: Sequence[Episode], group: Mapping[str, str], share: Mapping[str, float]) -> dict[str, float]:
    """Episode id -> chance that a training sample comes from it: frames are drawn evenly within a group."""
    frames = dict.fromkeys(share, 0)
    for episode in episodes:
        frames[group[episode.id]] += taught(episode)
    return {e.id: share[group[e.id]] * taught(e) / frames[group[e.id]] for e in episodes}


def _place(lineage: str) -> float:
    """A lineage's place in [0, 1), by hash."""
    return int.from_bytes(hashlib.sha256(b"held out\0" + lineage.encode()).digest()[:6]) / 2**48
