"""Statement: what a redaction did to a dataset version, in hashes and counts; signed by the store that did it."""

from typing import Literal

from pydantic import Field

from schemas.base import Frozen, Sha256, ShortId
from schemas.redaction import RedactionMap


class Change(Frozen):
    """Something before and after."""

    before: Sha256 = Field(description="keyed: who lacks the store's key cannot find out by trying what it was")
    after: Sha256 | None = Field(description="sha256 of what is in the version")


class VideoChange(Frozen):
    """The video of one episode and camera."""

    before: Sha256 = Field(description="sha256 of the parent's file")
    after: Sha256 | None = Field(description="sha256 of the version's file; None where the camera was removed")
    regions: int = Field(default=0, ge=0, description="regions of the map that count in it")
    faces: int = Field(default=0, ge=0, description="finds of the first look, added up over frames")
    frames_with_faces: int = Field(default=0, ge=0, description="of the first look")
    frames_covered: int = Field(default=0, ge=0, description="frames with something hidden for a face")
    frames_blanked: int = Field(default=0, ge=0, description="frames hidden whole after the second look")
    looks: int = Field(default=0, ge=0, description="how often it was looked through; the last look was clean")


class EpisodeChange(Frozen):
    """One episode: its frames, its row of the episodes table, its videos by camera."""

    data: Change
    meta: Change
    videos: dict[str, VideoChange]


class Statement(Frozen):
    """One redaction. Every file of the version but the manifest and this statement is named with its sha256."""

    format: Literal["hardcase-redaction-1"] = "hardcase-redaction-1"
    version: ShortId
    parent: ShortId
    parent_digest: Sha256 = Field(description="keyed, of the parent's digest, which covers each of its files")
    code: Sha256 = Field(description="hash of the source files that derived it")
    map: RedactionMap
    detector: dict[str, str] | None = Field(description="model, its sha256, versions; None where none was needed")
    software: dict[str, str] = Field(description="package -> version")
    counts: dict[str, int]
    episodes: dict[ShortId, EpisodeChange] = Field(description="in the order of the version")
    files: dict[str, Sha256]
    manifest: Sha256 = Field(description="of the manifest without the digests of files, keys sorted")
    erased: tuple[ShortId, ...] = Field(default=(), description="episodes that were forgotten since; signed again then")
