"""Who may be learnt from: the one question that every door to a training set asks.

The moment of use is an argument. Whoever stands at the border (a command, the flow) reads the clock; nothing that is
hashed does.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from pipeline.errors import ConsentError
from schemas.consent import SIMULATED, Consent, Purpose
from schemas.episode import Episode, Origin

SIMULATED_ORIGINS: tuple[Origin, ...] = ("scripted", "replayed", "retargeted", "deployed", "corrected", "oracle")
"""Origins of episodes that a simulator can make alone."""

DRIVEN: tuple[Origin, ...] = ("teleop", "ingested", "imported")
"""Origins of episodes whose demonstrations a person gave."""

SIMULATED_ACTORS = ("expert", "stand-in")
"""Who commands an episode in place of a person: the scripted expert, and the stand-in for an operator."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """Why an episode may not be used now."""

    reason: str
    record: str | None = None
    """Id of the record that does not hold; None where there is none."""
    ended: bool = False
    """Whether it held once: it expired or was revoked."""


@dataclass(frozen=True, slots=True)
class Consents:
    """The consent records of a store, and the moment at which episodes are to be used."""

    records: Mapping[str, Consent]
    """Id -> record, revoked and expired ones included."""
    now: datetime
    """Moment of use, with its time zone."""
    purpose: Purpose = "training"

    def check(self, episodes: Iterable[Episode], known: Iterable[Episode] = ()) -> None:
        """Let episodes pass whose people agree, or refuse the first whose people do not.

        An episode that was made from others needs the consent of everybody in its chain of parents.

        Args:
            episodes: what is to be used.
            known: further episodes; parents are looked up among both.

        Raises:
            ConsentError: names the episode, the record, what is wrong with it, and the mend.
        """
        for episode, found in self._flaws(episodes, known):
            for at, flaw in found:
                made_from = "" if at.id == episode.id else f"made from episode {at.id}: "
                raise self._refusal(episode.id, flaw, f"episode {episode.id}: {made_from}{flaw.reason}")

    def standing(self, episodes: Iterable[Episode], known: Iterable[Episode] = ()) -> list[Episode]:
        """The episodes without those that rest on a consent which has ended, in order.

        Who took a consent back, or let it run out, need not tell every loop that their episodes are in. What
        never had a consent stays in: that is a mistake, and `check` names it.
        """
        return [e for e, found in self._flaws(episodes, known) if not any(flaw.ended for _, flaw in found)]

    def check_needs(self, needed: Mapping[str, Iterable[str]], where: object) -> None:
        """Refuse the first episode that rests on a record which does not hold.

        Args:
            needed: episode id -> ids of the records that it rests on; see `needs`.
            where: what holds these episodes.

        Raises:
            ConsentError: names the episode, the record, what is wrong with it, and the mend.
        """
        for episode, ids in needed.items():
            for id in ids:
                if (flaw := self._of_record(id)) is not None:
                    raise self._refusal(episode, flaw, f"{where}: {flaw.reason}")

    def flaw(self, episode: Episode) -> Flaw | None:
        """Why this episode, its parents aside, may not be used now; None if it may."""
        if episode.consent == SIMULATED and _nobody_in(episode):
            return None
        record = self.records.get(episode.consent)
        if record is not None and (others := _people(episode) - {record.operator}):
            return Flaw(f"consent {record.id} is not of {min(others)!r}", record.id)
        return self._of_record(episode.consent)

    def ends(self, record: Consent) -> Flaw | None:
        """Why this record does not hold now; None if it does."""
        today = self.now.astimezone(UTC).date()
        if record.revoked is not None:
            day = record.revoked.astimezone(UTC).date()
            return Flaw(f"consent {record.id} was revoked on {day}", record.id, ended=True)
        if today > record.expires:
            return Flaw(f"consent {record.id} expired on {record.expires}", record.id, ended=True)
        if today < record.given:
            return Flaw(f"consent {record.id} holds from {record.given} on", record.id)
        if self.purpose not in record.purposes:
            return Flaw(f"consent {record.id} is for {', '.join(record.purposes)}", record.id)
        return None

    def _of_record(self, id: str) -> Flaw | None:
        record = self.records.get(id)
        return Flaw(f"its consent is {id!r}") if record is None else self.ends(record)

    def _flaws(self, episodes: Iterable[Episode],
               known: Iterable[Episode]) -> list[tuple[Episode, list[tuple[Episode, Flaw]]]]:
        chosen = list(episodes)
        by_id = {e.id: e for e in (*known, *chosen)}
        return [(e, [(at, flaw) for at in _chain(e, by_id) if (flaw := self.flaw(at)) is not None]) for e in chosen]

    def _refusal(self, episode: str, flaw: Flaw, where: str) -> ConsentError:
        """The one error of every door."""
        kind = "no" if flaw.record is None else "no valid"
        mend = "leave the episode out, " + (
            "or have the person consent first: hardcase consent add, then record with --consent; "
            "of a foreign log, name it in the map: consent, operator"
            if flaw.record is None else f"or look at the record: hardcase consent show {flaw.record}")
        return ConsentError(f"episode {episode} has {kind} consent record; it cannot be used for {self.purpose}",
                            where=where, mend=mend)


NO_CONSENTS = Consents({}, datetime(1, 1, 1, tzinfo=UTC))
"""Where no person's consent is known: only episodes without a person pass."""


def needs(episodes: Iterable[Episode], known: Iterable[Episode] = ()) -> dict[str, tuple[str, ...]]:
    """Episode id -> ids of the consent records that it rests on: its own and those of everything it was made from."""
    chosen = list(episodes)
    by_id = {e.id: e for e in (*known, *chosen)}
    return {e.id: tuple(dict.fromkeys(a.consent for a in _chain(e, by_id) if a.consent != SIMULATED)) for e in chosen}


def _nobody_in(episode: Episode) -> bool:
    """Whether a simulator made the episode alone: its origin allows it, and nobody but a stand-in commanded it."""
    actors = {s.actor for s in episode.segments if s.kind != "autonomous"}
    return episode.origin in SIMULATED_ORIGINS and actors <= set(SIMULATED_ACTORS)


def _people(episode: Episode) -> set[str]:
    """Pseudonyms of those who drove the robot by hand, as far as the record names them."""
    driven = [s.actor for s in episode.segments
              if s.kind == "intervention" or (s.kind == "demonstration" and episode.origin in DRIVEN)]
    return set(driven) - set(SIMULATED_ACTORS)


def _chain(episode: Episode, by_id: Mapping[str, Episode]) -> list[Episode]:
    """The episode and the known ones that it was made from; a circle is walked once."""
    found: dict[str, Episode] = {}
    here: Episode | None = episode
    while here is not None and here.id not in found:
        found[here.id] = here
        here = by_id.get(here.parent or "")
    return list(found.values())
