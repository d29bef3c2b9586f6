"""Which lineages are held out, and how much each group of episodes weighs."""

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from pipeline.errors import ConfigError, DatasetError
from pipeline.lerobot_view.tables import taught
from schemas.episode import VARIANTS, Episode

GROUPS = ("base", "corrections")

DRAWN = 1 << 59
"""Seeds of pipeline.simulation.tasks.scene_seed are not below this; smaller ones were not drawn for one start."""


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


def starts(episodes: Iterable[Episode]) -> dict[str, str]:
    """Episode id -> its start by seed family and seed, for the episodes whose seed was drawn.

    An id of an episode may follow from the policy that acted, and so from code and versions; where the
    attempt began does not. A seed that nobody drew (a robot's log has none) says nothing and is left out.
    """
    return {e.id: f"{e.scene.family} {e.scene.seed}" for e in episodes if e.scene.seed >= DRAWN}


def held_out(roots: Mapping[str, str], share: float, decided: Decided,
             start: Mapping[str, str] = MappingProxyType({})) -> frozenset[str]:
    """The lineages of the validation split.

    Lineages that begin at the same start are on the same side. What an earlier version decided stands;
    where it held out one of what turns out to belong together, all of it is held out. Anything else is
    held out if the hash of its start falls into `share`, which no other episode, order or generation, and
    no code, can change; the lineage's id stands in where no start is known. Both sides get at least one
    start where there are two.

    Args:
        roots: episode id -> lineage, of the episodes of the version.
        share: expected share of starts that are held out, 0 to 0.5.
        decided: what the parent version knows.
        start: episode id -> start, of the roots that are known.

    Raises:
        DatasetError: nothing is left to train on.
    """
    members: dict[str, set[str]] = {}
    for episode, root in roots.items():
        members.setdefault(start.get(root, root), set()).update((episode, root))
    held = {unit for unit, ids in members.items() if ids & decided.held_out}
    undecided = sorted((u for u, ids in members.items() if not ids & (decided.held_out | decided.train)), key=_place)
    held |= {unit for unit in undecided if _place(unit) < share}
    if share > 0 and not held and undecided and len(members) > 1:
        held = {undecided[0]}
    if len(held) == len(members) and undecided:
        held.remove(undecided[-1])
    if len(held) == len(members):
        raise DatasetError("every lineage of this version is held out", where=f"{len(roots)} episodes",
                           mend="add demonstrations, or start a version without a parent")
    return frozenset(root for root in roots.values() if start.get(root, root) in held)


def groups(episodes: Iterable[Episode], known: Mapping[str, Episode]) -> dict[str, str]:
    """Episode id -> base (demonstrations of generation 0 and every variant) or corrections.

    Corrections are what a person or the oracle gave on the robot itself: few frames, which their many variants
    would crowd out of a common group. What any later generation recorded weighs as much, so that a control arm
    with fresh demonstrations differs in its data and in nothing else.

    Args:
        episodes: episodes of the version.
        known: every episode by id, those that the filter left out included.
    """
    def corrected(episode: Episode | None) -> bool:
        while episode is not None and episode.origin not in ("corrected", "oracle"):
            episode = known.get(episode.parent or "")
        return episode is not None

    return {e.id: GROUPS[e.origin not in VARIANTS and (e.generation > 0 or corrected(e))] for e in episodes}


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


def _place(unit: str) -> float:
    """The place in [0, 1) of a start, or of a lineage without one, by hash."""
    return int.from_bytes(hashlib.sha256(b"held out\0" + unit.encode()).digest()[:6]) / 2**48
