"""What a live recording says of itself: at its start what is known then, at its end how it went."""

from collections.abc import Mapping

from pipeline.recording.metadata import SEAL, episode_metadata, seal
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


def start_metadata(episode: Episode, software: Mapping[str, str]) -> dict[str, str]:
    """Strings of the record at the head, sealed: in a file cut short no CRC of the data section covers them."""
    values = episode_metadata(episode, software=software, truncated=True)
    known = {key: text for key, text in values.items() if key not in (*_UNKNOWN, SEAL)}
    return {**known, SEAL: seal(known)}


def final_metadata(episode: Episode, software: Mapping[str, str]) -> dict[str, str]:
    """Strings of the record `episode` at the end."""
    return episode_metadata(episode, software=software, truncated=False)
