"""What a conversion is known by: the log, what the map says about reading, and the code; equal ids mean equal bytes."""

import json
from pathlib import Path

from pipeline import arrow, frames
from pipeline.files import sha256, short_id, source_hash
from pipeline.logs.convert import CAMERA
from schemas import conversion as shapes
from schemas import ingest as maps
from schemas.ingest import IngestMap

LABELS = ("name", "task", "consent", "operator", "site")
"""What a map says about episodes and not about reading: a change of these converts nothing again."""
OTHERS = ("child", "fingerprint", "inspection", "roles", "suggest", "survey", "worker")
"""Modules of pipeline/logs that change no byte of a conversion."""
SHARED = ("errors", "fields", "records", "unpacking")
"""Modules of pipeline/recording that read the records of any log."""


def conversion_id(sha: str, declared: IngestMap, *, accept_truncated: bool = False) -> str:
    """Id of what a log becomes: it follows from the log, what the map says about reading, and the code."""
    return short_id("conversion", sha, reads_hash(declared), code_hash(), accept_truncated)


def camera_hashes(declared: IngestMap, *, accept_truncated: bool = False) -> dict[str, str]:
    """camera.NAME -> hash of what decides which images are taken of a log; which frame uses which plays no part."""
    told = {name: [c.topic, c.field, c.clock or declared.clock, accept_truncated]
            for name, c in declared.cameras.items()}
    return {CAMERA + name: sha256(json.dumps(parts).encode()) for name, parts in told.items()}


def code_hash() -> str:
    """Hash of every source file that decides which frames a log becomes."""
    here = Path(__file__).parent
    ours = [file for file in here.glob("*.py") if file.stem not in OTHERS]
    shared = [here.parent / "recording" / f"{name}.py" for name in SHARED]
    return source_hash([*ours, *shared, *(Path(m.__file__ or "") for m in (arrow, frames, maps, shapes))])


def reads_hash(declared: IngestMap) -> str:
    """Hash of what a map says about reading."""
    told = declared.model_dump(mode="json", exclude=set(LABELS))
    return sha256(json.dumps(told, sort_keys=False).encode())
