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

SIMULATED_ACTORS = ("expert", "stand-in")
"""Who commands an episode in place of a person: the scripted expert, and the stand-in for an operator."""


@dataclass(frozen=True, slots=True)
class Consents:
    """The consent records of a store, and the moment at which episodes are to be used."""

    records: Mapping[str, Consent]
    """Id -> record, revoked and expired ones included."""
    now: datetime
    """Moment of use, with its time zone."""

    def check(self, episodes: Iterable[Episode], known: Iterable[Episode] = (), *,
              purpose: Purpose = "training") -> None:
        """Let episodes pass whose people agree, or refuse the first whose people do not.

        An episode that was made from others needs the consent of everybody in its chain of parents.

        Args:
            episodes: what is to be used.
            known: further episodes; parents are looked up among both.
            purpose: what for.

        Raises:
            ConsentError: names the episode, the record, what is wrong with it, and the mend.
        """
        chosen = list(episodes)
        by_id = {e.id: e for e in (*known, *chosen)}
        for episode in chosen:
            for ancestor in _chain(episode, by_id):
                if (reason := self.fault(ancestor, purpose)) is not None:
                    raise refusal(episode, ancestor, reason, purpose)

    def allowed(self, episodes: Iterable[Episode], known: Iterable[Episode] = (), *,
                purpose: Purpose = "training") -> list[Episode]:
        """Those of the episodes that `check` lets pass, in order."""
        chosen = list(episodes)
        by_id = {e.id: e for e in (*known, *chosen)}
        return [e for e in chosen if all(self.fault(a, purpose) is None for a in _chain(e, by_id))]

    def fault(self, episode: Episode, purpose: Purpose = "training") -> str | None:
        """Why this episode, its parents aside, may not be used now; None if it may."""
        if episode.consent == SIMULATED:
            return None if nobody_in(episode) else "no consent record"
        consent = self.records.get(episode.consent)
        if consent is None:
            return "no consent record"
        others = sorted(_people(episode) - {consent.operator})
        return f"consent {consent.id} is not of {others[0]!r}" if others else self.flaw(consent, purpose)

    def flaw(self, consent: Consent, purpose: Purpose = "training") -> str | None:
        """Why this record does not hold now; None if it does."""
        today = self.now.astimezone(UTC).date()
        if consent.revoked is not None:
            return f"consent {consent.id} was revoked on {consent.revoked.astimezone(UTC):%Y-%m-%d}"
        if today > consent.expires:
            return f"consent {consent.id} expired on {consent.expires}"
        if today < consent.given:
            return f"consent {consent.id} holds from {consent.given} on"
        if purpose not in consent.purposes:
            return f"consent {consent.id} is for {', '.join(consent.purposes)}"
        return None


NO_CONSENTS = Consents({}, datetime(1, 1, 1, tzinfo=UTC))
"""Where no person's consent is known: only episodes without a person pass."""


def nobody_in(episode: Episode) -> bool:
    """Whether a simulator made the episode alone: its origin allows it, and nobody but a stand-in commanded it."""
    actors = {s.actor for s in episode.segments if s.kind != "autonomous"}
    return episode.origin in SIMULATED_ORIGINS and actors <= set(SIMULATED_ACTORS)


def refusal(episode: Episode, at: Episode, reason: str, purpose: Purpose = "training") -> ConsentError:
    """The one error of every door: `at` is the episode or the ancestor whose consent is wanting."""
    kind = "" if reason == "no consent record" else "valid "
    made_from = "" if at.id == episode.id else f"made from episode {at.id}: "
    where = f"episode {episode.id}: {made_from}" + (f"its consent is {at.consent!r}" if not kind else reason)
    mend = ("leave the episode out, or have the person consent first: hardcase consent add, then record with --consent"
            if not kind else f"leave the episode out, or look at the record: hardcase consent show {at.consent}")
    return ConsentError(f"episode {episode.id} has no {kind}consent record; it cannot be used for {purpose}",
                        where=where, mend=mend)


def _people(episode: Episode) -> set[str]:
    """Pseudonyms of those who drove the robot by hand, as far as the record names them."""
    driven = [s.actor for s in episode.segments
              if s.kind == "intervention" or (s.kind == "demonstration" and episode.origin == "teleop")]
    return set(driven) - set(SIMULATED_ACTORS)


def _chain(episode: Episode, by_id: Mapping[str, Episode]) -> list[Episode]:
    """The episode and the known ones that it was made from; a circle is walked once."""
    found: dict[str, Episode] = {}
    here: Episode | None = episode
    while here is not None and here.id not in found:
        found[here.id] = here
        here = by_id.get(here.parent or "")
    return list(found.values())
