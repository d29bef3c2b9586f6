"""What was judged to hurt must not teach: the question that builds and releases ask."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from schemas.dataset import DatasetVersion
from schemas.episode import VARIANTS, Episode
from schemas.worth import BatchWorth


@dataclass(frozen=True, slots=True)
class Worths:
    """The batches whose last verdict is HURTS; what was never judged, or was judged otherwise since, is free."""

    hurting: Sequence[BatchWorth] = ()

    def against(self, episodes: Iterable[Episode], known: Iterable[Episode] = ()) -> dict[str, BatchWorth]:
        """Id of each of these episodes that is in such a batch, or was made from one that is -> the verdict.

        Args:
            episodes: what may be used.
            known: further episodes; parents of variants are looked up among both.
        """
        chosen = list(episodes)
        by_id = {e.id: e for e in (*known, *chosen)} if self.hurting else {}
        bad = {id: worth for worth in self.hurting for id in worth.episodes}
        found = {e.id: _bad(e, by_id, bad) for e in chosen} if bad else {}
        return {id: worth for id, worth in found.items() if worth is not None}

    def spared(self, episodes: Iterable[Episode], known: Iterable[Episode] = ()) -> list[Episode]:
        """The episodes that no verdict stands against, in order."""
        chosen = list(episodes)
        out = self.against(chosen, known)
        return [e for e in chosen if e.id not in out]

    def in_version(self, version: DatasetVersion) -> BatchWorth | None:
        """The first batch that hurts and that has an episode in the version."""
        held = set(version.episodes)
        return next((w for w in self.hurting if not held.isdisjoint(w.episodes)), None)


def _bad(episode: Episode, by_id: dict[str, Episode], bad: dict[str, BatchWorth]) -> BatchWorth | None:
    """The verdict on the episode or, for a variant, on one that its frames were made from."""
    here, seen = episode, set[str]()
    while here.id not in bad and here.id not in seen and here.origin in VARIANTS and (here.parent or "") in by_id:
        seen.add(here.id)
        here = by_id[here.parent or ""]
    return bad.get(here.id)


NO_WORTHS = Worths()
"""Where nothing was judged."""
