"""Erasure: what was forgotten, when and why; what is left of it are ids and hashes."""

from typing import Literal

from pydantic import AwareDatetime, Field

from schemas.base import Frozen, Sha256, ShortId

type ErasedKind = Literal["episode", "hard_case", "raw_log", "conversion", "blob"]


class Erasure(Frozen):
    """One call of `hardcase forget`: everything that goes, listed before the first byte does."""

    id: ShortId = Field(description="follows from the episode: it can be forgotten once")
    episode: ShortId = Field(description="the attempt that was asked for")
    reason: str = Field(min_length=1, max_length=500)
    at: AwareDatetime = Field(description="when it was ordered")
    episodes: tuple[ShortId, ...] = Field(description="it, and all that holds frames or the start of it")
    hard_cases: tuple[ShortId, ...] = ()
    raw_logs: tuple[Sha256, ...] = Field(default=(), description="foreign logs that held it")
    conversions: tuple[ShortId, ...] = ()
    blobs: tuple[Sha256, ...] = Field(description="files that go; nobody else's bytes are in them")
    shards: tuple[Sha256, ...] = Field(default=(), description="files of many variants, written anew without these")
    versions: tuple[ShortId, ...] = Field(default=(), description="dataset versions that held one of the episodes")
    policies: tuple[ShortId, ...] = Field(default=(), description="policies that were trained on one of these versions")
    runs: tuple[ShortId, ...] = Field(default=(), description="runs whose reports may show one of the episodes")
