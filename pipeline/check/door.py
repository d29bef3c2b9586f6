"""What failed its checks must not teach: the one question that every door to a training set asks."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pipeline.errors import DatasetError
from schemas.dataset import DatasetVersion
from schemas.episode import VARIANTS, Episode
from schemas.finding import CheckVerdict


@dataclass(frozen=True, slots=True)
class Verdicts:
    """The last verdict on every recording and version that was checked; what was never checked is free."""

    by_subject: Mapping[str, CheckVerdict]
    """sha256 of a recording, or digest of a version -> verdict."""

    def passing(self, episodes: Iterable[Episode], known: Iterable[Episode] = ()) -> list[Episode]:
        """The episodes without those that failed, or whose frames were made from one that failed, in order.

        Args:
            episodes: what may be used.
            known: further episodes; parents are looked up among both.
        """
        chosen = list(episodes)
        by_id = {e.id: e for e in (*known, *chosen)}
        return [e for e in chosen if self._failed(e, by_id) is None]

    def check(self, episodes: Iterable[Episode], known: Iterable[Episode] = ()) -> None:
        """Refuse the first of these episodes that failed.

        Raises:
            DatasetError: names the episode, what was found, and the mend.
        """
        chosen = list(episodes)
        by_id = {e.id: e for e in (*known, *chosen)}
        for episode in chosen:
            if (found := self._failed(episode, by_id)) is not None:
                at, verdict = found
                made_from = "" if at.id == episode.id else f", made from episode {at.id},"
                raise DatasetError(f"episode {episode.id}{made_from} failed its check; it cannot be used for training",
                                   where=verdict.reason, mend="leave the episode out; see all that was found: "
                                   f"hardcase check {at.id}; a false alarm: check it again with --contract")

    def check_version(self, version: DatasetVersion, episodes: Iterable[Episode],
                      known: Iterable[Episode] = ()) -> None:
        """Refuse a version that failed, or that holds an episode that has failed since it was built.

        Raises:
            DatasetError: names the version or the episode, what was found, and the mend.
        """
        verdict = self.by_subject.get(version.digest)
        if verdict is not None and not verdict.passed:
            raise DatasetError(f"version {version.id} failed its check; it cannot be used for training",
                               where=verdict.reason, mend=f"see all that was found: hardcase check {version.id}; then "
                               "build a version without it, or check this one again with --contract")
        self.check(episodes, known)

    def _failed(self, episode: Episode, by_id: Mapping[str, Episode]) -> tuple[Episode, CheckVerdict] | None:
        """The episode or, for a variant, the one that its frames were made from, if its last verdict is a failure."""
        here, seen = episode, set[str]()
        while here.origin in VARIANTS and here.id not in seen and (parent := by_id.get(here.parent or "")) is not None:
            seen.add(here.id)
            here = parent
        verdict = self.by_subject.get(here.blob or "")
        return None if verdict is None or verdict.passed else (here, verdict)


NO_VERDICTS = Verdicts(MappingProxyType({}))
"""Where nothing was checked."""
