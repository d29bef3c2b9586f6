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


class Capital(Frozen):
    """The bets against one claim; see pipeline.statistics.betting for the formula of each."""

    claim: Literal["no better", "loses the margin"]
    stratum: str = Field(description="'all', or the family of scenes that the claim is about")
    scenes: int = Field(ge=0)
    fixed: int = Field(ge=0)
    broken: int = Field(ge=0)
    log_capital: float = Field(description="natural logarithm; the claim has fallen at -log(stake)")


class LostScene(Frozen):
    """A regression scene that the champion solves and the candidate does not."""

    seed: int = Field(description="of the scene")
    stratum: str
    candidate: int = Field(ge=0, description="successes")
    champion: int = Field(ge=0, description="successes, over as many perception seeds")
    family: str = Field(default="", description="failure family that it was fixed in")


class Regression(Frozen):
    """The scenes that no release may lose; they can veto, and nothing else."""

    scenes: int = Field(ge=1)
    seeds: int = Field(ge=1, description="times that each was played, and again where it seemed lost")
    at_most: int = Field(ge=0, description="successes of the candidate at which a scene is lost")
    lost: tuple[LostScene, ...]
    chance: float = Field(ge=0, le=1, description="of a veto between equal policies, at most")


class Selection(Frozen):
    """Which of several trainings is the candidate: most scenes solved, the first trained where they are equal."""

    scenes: int = Field(ge=1, description="of the family 'selection', which no test uses")
    solved: dict[str, int] = Field(description="policy -> scenes solved, in the order of training")
    chosen: ShortId


class NightTest(Frozen):
    """What a night staked of its budget, and every number that decided."""

    stake: float = Field(gt=0, description="chance of a false promotion tonight, at most")
    capitals: tuple[Capital, ...] = Field(description="of every claim that a promotion has to refute")
    given_back: float = Field(ge=0, description="what is left of the stake")
    alpha_fail: float = Field(description="error of FAIL, tonight alone")
    regression: Regression | None = None
    selection: Selection | None = None


def _not_at_night(tonight: object) -> bool:
    """Verdicts of other gates stay as they were."""
    return tonight is None


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
    tonight: NightTest | None = Field(default=None, exclude_if=_not_at_night, description="of the nightly gate only")
