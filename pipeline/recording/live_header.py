"""What a live recording says of itself: at its start what is known then, at its end how it went."""

from collections.abc import Iterable, Mapping

from pipeline.recording.metadata import SEAL, episode_metadata, seal
from schemas.consent import Consent
from schemas.episode import Episode, Outcome, Segment

START = "episode_start"
"""Metadata record at the head of the file: the Episode as far as it is known before anything happened."""
_UNKNOWN = ("frames", "outcome", "reason", "truncated")
"""Strings that only the end can tell."""


def beginning(*, kind: str = "demonstration", actor: str, **known: object) -> Episode:
    """The Episode of a recording that starts: one frame, outcome unknown, `actor` in command.

    Args:
        kind: demonstration, autonomous or intervention.
        actor: who commands first: a policy id, 'expert', or an operator's pseudonym.
        known: id, origin, scene, control_hz, generation, and whatever else an Episode holds.

    Raises:
        ValidationError: a field is missing or has a value that an Episode cannot have.
    """
    first = Segment.model_validate({"kind": kind, "start": 0, "stop": 1, "actor": actor})
    unknown = Outcome(label="unknown", judged_by="operator")
    return Episode.model_validate({**known, "frames": 1, "outcome": unknown, "segments": (first,)})


def start_metadata(episode: Episode, software: Mapping[str, str], consent: Consent | None) -> dict[str, str]:
    """Strings of the record at the head, sealed: in a file cut short no CRC of the data section covers them."""
    values = episode_metadata(episode, software=software, truncated=True, consent=consent)
    known = {key: text for key, text in values.items() if key not in (*_UNKNOWN, SEAL)}
    return {**known, SEAL: seal(known)}


def segments_of(starts: Iterable[tuple[int, str, str]], frames: int) -> tuple[Segment, ...]:
    """Segments from (first frame, kind, actor) of those who took command, in order."""
    inside = [start for start in starts if start[0] < frames]
    stops = [*(start[0] for start in inside[1:]), frames]
    return tuple(Segment.model_validate({"kind": kind, "start": start, "stop": stop, "actor": actor})
                 for (start, kind, actor), stop in zip(inside, stops, strict=True))


def cut_off(start: Episode, frames: int, changes: Iterable[tuple[int, str]], why: str) -> Episode:
    """The Episode of a recording that was never closed: how it ended is not known.

    Args:
        start: what was known when it began.
        frames: ticks that were kept.
        changes: (tick, text) of the events named 'segment', in order; see LiveRecorder.segment.
        why: what ended it.
    """
    first = start.segments[0]
    starts = [(0, str(first.kind), first.actor)]
    for tick, text in changes:
        kind, _, actor = text.partition(" ")
        starts = [s for s in starts if s[0] < tick] + [(tick, kind, actor)]
    outcome = Outcome(label="unknown", judged_by=start.outcome.judged_by,
                      reason=f"truncated: {frames} frames kept; {why}")
    return Episode.model_validate(start.model_dump() | {
        "frames": frames, "outcome": outcome, "segments": segments_of(starts, frames)})
