"""The metadata record `episode`: who, what and how it ended, as strings any MCAP tool shows."""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from pipeline.files import sha256
from pipeline.recording import records
from pipeline.recording.dialect import SCHEMA_VERSION
from schemas.consent import SIMULATED, Consent
from schemas.episode import Episode

NAME, SEAL = "episode", "sha256"


def episode_metadata(episode: Episode, *, software: Mapping[str, str], truncated: bool,
                     consent: Consent | None = None) -> dict[str, str]:
    """Strings of the record; `episode_json` holds the whole Episode without its blob, the file's own hash.

    Args:
        episode: what was attempted.
        software: software_commit, simulator_version and further strings.
        truncated: whether the end is missing.
        consent: the record that the episode refers to, where a person was recorded.
    """
    scene, outcome = episode.scene, episode.outcome
    values = {
        "schema_version": SCHEMA_VERSION,
        "episode": episode.id,
        "origin": episode.origin,
        "robot": scene.robot,
        "scene": scene.scene,
        "task": scene.task,
        **consent_strings(episode, consent),
        "outcome": outcome.label,
        "reason": outcome.reason or "",
        "family": scene.family,
        "stratum": scene.stratum,
        "seed": str(scene.seed),
        "twin": "" if scene.twin is None else str(scene.twin),
        "generation": str(episode.generation),
        "control_hz": str(episode.control_hz),
        "frames": str(episode.frames),
        "truncated": str(truncated).lower(),
        "software_commit": "unknown",
        "simulator_version": _simulator(),
        **software,
        "episode_json": episode.model_copy(update={"blob": None}).model_dump_json(),
    }
    return {**values, SEAL: seal(values)}


def consent_strings(episode: Episode, consent: Consent | None) -> dict[str, str]:
    """Who was recorded (by pseudonym), where, for what and until when it may be used; a simulation says so."""
    actors = [s.actor for s in episode.segments if s.kind != "autonomous"]
    unsaid = SIMULATED if episode.consent == SIMULATED else "unknown"
    said = {"operator": actors[0] if actors else "none", "site": unsaid, "purpose": unsaid, "expires": unsaid}
    return {"consent": episode.consent, **(said if consent is None else record_strings(consent))}


def record_strings(consent: Consent) -> dict[str, str]:
    """What a consent record says, in the words of the metadata."""
    return {"operator": consent.operator, "site": consent.site, "purpose": ",".join(consent.purposes),
            "expires": consent.expires.isoformat()}


def seal(values: Mapping[str, str]) -> str:
    """sha256 over the strings: in a file cut short, no CRC of the data section covers them."""
    return sha256(records.pairs({key: text for key, text in values.items() if key != SEAL}))


@cache
def _simulator() -> str:
    try:
        return f"mujoco {version('mujoco')}"
    except PackageNotFoundError:
        return "unknown"
