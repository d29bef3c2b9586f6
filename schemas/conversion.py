"""RawLog, Conversion, Ingestion: somebody else's log, what was made of it, and what was said about it."""

from typing import Literal

from pydantic import Field

from schemas.base import Frozen, Name, Sha256, ShortId
from schemas.ingest import IngestMap


class RawLog(Frozen):
    """A log as it came, stored untouched under its hash."""

    id: Sha256 = Field(description="of its bytes; also the name of its blob")
    size_bytes: int = Field(ge=0)
    source: str = Field(description="the path it was first ingested from, as it was given")


class TopicUse(Frozen):
    """One topic of a log and what became of it."""

    topic: str
    type: str
    encoding: str
    messages: int = Field(ge=0)
    use: Literal["used", "unused", "undecodable"]
    reason: str = Field(default="", description="why it cannot be decoded")
    left_out: dict[str, int] = Field(default={}, description="reason -> messages of a used topic that were not used")


class Span(Frozen):
    """One episode that was made: frames of an even clock without a hole."""

    boundary: int = Field(ge=0, description="number of the episode by the declared boundaries")
    part: int = Field(ge=0, description="0; 1, 2, ... for what follows a hole")
    start_ns: int = Field(description="time of frame 0 on the map's clock [ns]")
    frames: int = Field(gt=0)
    label: Literal["success", "failure", "unknown"]


class Skew(Frozen):
    """How far the samples of a feature or camera lie from the frames that use them."""

    median_s: float = Field(description="of the distances [s]")
    max_s: float = Field(description="largest distance [s]")


class CameraFile(Frozen):
    """The images of one camera, as they came."""

    images: int = Field(ge=0)
    left_out: dict[str, int] = Field(default={}, description="reason -> messages without a usable image")
    format: str = Field(description="jpeg, png, or how the log calls it")


class Converted(Frozen):
    """What one reading of a log by a map gave."""

    features: dict[str, tuple[str, ...]] = Field(description="feature -> names of its values, skews included")
    cameras: dict[Name, CameraFile] = Field(default={})
    spans: tuple[Span, ...] = ()
    topics: tuple[TopicUse, ...] = ()
    skews: dict[str, Skew] = Field(default={}, description="feature or camera.NAME -> skew")
    problems: tuple[str, ...] = Field(default=(), description="what was odd, lost or left out, one line each")


class Conversion(Frozen):
    """A log read by a map with one state of the code; the id follows from the three."""

    id: ShortId
    log: Sha256
    reads: Sha256 = Field(description="hash of what the map says about reading; its labels do not count")
    code: Sha256 = Field(description="hash of the source files that convert")
    state: Literal["converted", "quarantined", "refused"]
    reason: str = Field(default="", description="why it was not converted")
    mend: str = Field(default="", description="what a person can do about it")
    result: Converted | None = None
    files: dict[str, Sha256] = Field(default={}, description="frames, camera.NAME -> blob")
    made_from: dict[str, Sha256] = Field(
        default={}, description="camera.NAME -> hash of what decides its bytes besides log and code"
    )


class Ingestion(Frozen):
    """A conversion with what the map says about its episodes: robot, task, consent, who and where."""

    id: ShortId
    conversion: ShortId
    declared: IngestMap
    episodes: tuple[ShortId, ...]
