"""Verdict: what the gate found, with every number needed to check it by hand."""

from typing import Literal

from pydantic import Field

from schemas.base import Frozen, ShortId


class Proportion(Frozen):
    """Successes among n with a Wilson interval."""

    n: int = Field(ge=0)
    successes: int = Field(ge=0)
    rate: float = Field(ge=0, le=1)
    low: float = Field(ge=0, le=1)
    high: float = Field(ge=0, le=1)


class StratumResult(Frozen):
    """Candidate against champion on the scenes of one stratum (or 'all')."""

    stratum: str
    candidate: Proportion
    champion: Proportion | None = None
    fixed: int = Field(default=0, ge=0, description="scenes the champion fails and the candidate solves")
    broken: int = Field(default=0, ge=0, description="scenes the champion solves and the candidate fails")
    p_gain: float | None = Field(default=None, description="one-sided exact McNemar p of a gain, not yet corrected")
    p_loss: float | None = Field(default=None, description="one-sided exact McNemar p of a loss, not yet corrected")
    loss_upper: float | None = Field(default=None, description="upper bound of success lost, as a share of scenes")


class Look(Frozen):
    """One interim look of the sequential test."""

    scenes: int
    alpha: float = Field(description="error this look may spend")
    decision: Literal["PASS", "FAIL", "continue"]


class Verdict(Frozen):
    """The gate's answer for one candidate."""

    id: ShortId
    candidate: ShortId
    champion: ShortId | None
    generation: int
    decision: Literal["PASS", "FAIL", "INCONCLUSIVE", "BOOTSTRAP"]
    reason: str
    strata: tuple[StratumResult, ...] = Field(description="'all' first, then every stratum")
    looks: tuple[Look, ...] = ()
    p: float | None = Field(default=None, description="smallest multiplicity-corrected p of a gain")
    scenes: int
    margin: float
    more_scenes: int | None = Field(default=None, description="further scenes that would decide; INCONCLUSIVE only")
