"""Ingest: somebody else's log and a declared map become a conversion, and that becomes episodes."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from pipeline.errors import ConfigError, RecordingError
from pipeline.files import short_id
from pipeline.lerobot_view.split import DRAWN
from pipeline.logs import convert as conversions
from pipeline.logs.child import Children, Limits
from pipeline.logs.identity import camera_hashes, code_hash, conversion_id, reads_hash
from pipeline.logs.inspection import Inspection, inspect
from pipeline.store.ingests import INGEST
from schemas.consent import NO_CONSENT
from schemas.conversion import CameraFile, Conversion, Converted, Ingestion
from schemas.episode import Episode, Outcome, Segment
from schemas.ingest import IngestMap, SaidOutcome
from schemas.scene import SceneSpec

NOTHING: Mapping[str, tuple[Path, CameraFile]] = MappingProxyType({})
LEAST_S, BYTES_A_SECOND, MESSAGES_A_SECOND = 3.5, 2e6, 1e4
"""CPU time for any log [s], and bytes and messages that are worth a second more: a fifth of the slowest that were
measured, JSON and messages of which no two are laid out alike. They were counted before, unpacked."""
PASSING = ("wall time", "died")
"""Words of reasons that may not hold the next time: a busy machine, one short of memory."""


def ingest(log: Path, declared: IngestMap, *, sha: str, folder: Path, children: Children,
           accept_truncated: bool = False, known: Mapping[str, tuple[Path, CameraFile]] = NOTHING) -> Conversion:
    """Convert one log in a limited child, or say why it cannot be; a bad log is a result, not an error.

    Args:
        log: an MCAP file, under whatever name.
        declared: how to read it.
        sha: hash of the log.
        folder: an empty folder for the files that are made: `frames`, and `camera.NAME` for each camera that is
            not known.
        children: where foreign files are read.
        accept_truncated: keep what comes before the first damage or missing byte.
        known: camera -> the file that an earlier conversion made of its images; see `camera_hashes`.

    Returns:
        The conversion without its files, whose hashes are known once they are stored.

    Raises:
        StoreError: the disk is full.
    """
    made = Conversion(id=conversion_id(sha, declared, accept_truncated=accept_truncated), log=sha,
                      reads=reads_hash(declared), code=code_hash(), state="refused",
                      made_from=camera_hashes(declared, accept_truncated=accept_truncated))
    try:
        there = {name: (str(file), told.model_dump(mode="json")) for name, (file, told) in known.items()}
        seen = inspect(log, accept_truncated=accept_truncated, children=children)  # what is hostile ends here
        told = children.call(conversions.convert, str(log), declared.model_dump_json(), str(folder), accept_truncated,
                             there, where=log, limits=_limits(seen))
    except RecordingError as error:
        return made.model_copy(update={"state": "quarantined", "reason": error.what, "mend": error.mend})
    except ConfigError as error:
        return made.model_copy(update={"reason": error.what, "mend": error.mend})
    return made.model_copy(update={"state": "converted", "result": Converted.model_validate(told)})


def lasts(made: Conversion) -> bool:
    """Whether a conversion would come out so again, and is worth keeping."""
    return made.state != "quarantined" or not any(words in made.reason for words in PASSING)


def episodes_of(made: Conversion, declared: IngestMap) -> tuple[Ingestion, list[Episode]]:
    """The episodes of a conversion, with what the map says about them."""
    assert made.result is not None, "only what was converted has episodes"
    id = short_id("ingestion", made.id, declared.model_dump_json())
    judged = "operator" if isinstance(declared.outcome, SaidOutcome) else "sensors"
    actor = declared.operator or "unknown"
    episodes = [
        Episode(id=short_id("ingested", id, span.boundary, span.part), origin="ingested",
                scene=_scene(made, declared, span.boundary), control_hz=declared.fps, frames=span.frames, generation=0,
                outcome=Outcome(label=span.label, judged_by=judged), transform=f"{INGEST}{id}",
                segments=(Segment(kind="demonstration", start=0, stop=span.frames, actor=actor),),
                blob=made.files[conversions.FRAMES], consent=declared.consent or NO_CONSENT)
        for span in made.result.spans
    ]
    return Ingestion(id=id, conversion=made.id, declared=declared, episodes=tuple(e.id for e in episodes)), episodes


def _limits(seen: Inspection) -> Limits:
    """What converting may take, by what the log is known to hold."""
    plain = sum(channel.bytes for channel in seen.channels)
    cpu_s = LEAST_S + plain / BYTES_A_SECOND + seen.messages / MESSAGES_A_SECOND
    return Limits(cpu_s=cpu_s, wall_s=30 + 4 * cpu_s)


def _scene(made: Conversion, declared: IngestMap, boundary: int) -> SceneSpec:
    """What is known of the start: nothing but who and what. Its seed is the same for every conversion of a log, so
    that a stretch of a log never stands on both sides of a split."""
    seed = DRAWN + int(short_id("start", made.log, boundary), 16) % DRAWN
    return SceneSpec(family="foreign", seed=seed, robot=declared.robot, scene=declared.site or "elsewhere",
                     task=declared.name, stratum="foreign", object_xy_m=(0, 0), object_yaw_rad=0, object_half_m=0,
                     target_xy_m=(0, 0))
