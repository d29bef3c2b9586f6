"""Judgement: who was right where two policies disagreed, and ShadowReport: what follows from many of them."""

from typing import Literal

from pydantic import Field

from schemas.base import Frozen, ShortId
from schemas.verdict import Proportion

type Right = Literal["champion", "candidate", "both", "neither"]
type Wrong = Literal["champion", "candidate", "both"]


class JudgeConfig(Frozen):
    """What counts as a lasting disagreement, and how thoroughly it is judged."""

    threshold: float = Field(
        default=0.04, gt=0, description="disagreement from which two policies are apart, in scales of the action")
    lasting: int = Field(default=3, ge=1, description="ticks that it has to stay there")
    draws: int = Field(
        default=16, ge=4, description="noise and physics draws of each policy; fewer than 4 can decide nothing")
    most: int | None = Field(
        default=None, ge=1, description="moments judged, large disagreements more often; all where None")
    checked: int = Field(
        default=50, ge=0, description="attempts, drawn at random, that both also play alone from the first tick")
    seed: int = Field(default=0, ge=0, description="of the draws, and of which moments are judged")


class Side(Frozen):
    """How one policy ended its branches of a moment."""

    policy: ShortId
    success: Proportion
    why: dict[str, int] = Field(default={}, description="failure family -> branches that it ended")

    @property
    def right(self) -> bool:
        """Whether it succeeded in at least half of its branches."""
        return 2 * self.success.successes >= self.success.n

    @property
    def decided(self) -> bool:
        """Whether the interval of its success leaves out one half."""
        return self.success.low > 0.5 or self.success.high < 0.5

    @property
    def main_reason(self) -> str | None:
        """The failure family that ended most branches, the first by name among equals; None where none failed."""
        return min(self.why, key=lambda name: (-self.why[name], name), default=None)


class Judgement(Frozen):
    """One disagreement, judged."""

    id: ShortId
    episode: ShortId
    tick: int = Field(ge=0, description="where the disagreement begins: both policies go on from here")
    lasted: int = Field(ge=1, description="ticks that the disagreement lasted in the recording")
    disagreement: float = Field(ge=0, description="mean over those ticks, in scales of the action")
    phase: str = Field(description="subtask at that tick")
    stratum: str = Field(description="kind of start, as perceived")
    champion: Side
    candidate: Side
    fixed: int = Field(ge=0, description="draws that only the candidate solves")
    broken: int = Field(ge=0, description="draws that only the champion solves")
    gain: float = Field(ge=-1, le=1, description="success of the candidate minus that of the champion")
    gain_low: float = Field(ge=-1, le=1, description="lower limit at 95 % (Tango's score interval of paired draws)")
    gain_high: float = Field(ge=-1, le=1)
    estimated: bool = Field(default=False, description="the state was estimated from what the robot sensed")
    replay_error_m: float = Field(
        default=0.0, ge=0, description="RMS by which the replayed commands miss the perceived object, the noise of "
        "perception included; 0 where the state is exact [m]")
    replay_error_rad: float = Field(default=0.0, ge=0, description="RMS by which they miss the joints [rad]")

    @property
    def verdict(self) -> Right:
        """Who was right: succeeded in at least half of its branches."""
        if self.champion.right:
            return "both" if self.candidate.right else "champion"
        return "candidate" if self.candidate.right else "neither"

    @property
    def decided(self) -> bool:
        """Whether the intervals of both leave out one half."""
        return self.champion.decided and self.candidate.decided

    @property
    def wrong(self) -> Wrong | None:
        """Who was wrong for certain: its interval lies below one half."""
        champion, candidate = (s.decided and not s.right for s in (self.champion, self.candidate))
        return "both" if champion and candidate else "champion" if champion else "candidate" if candidate else None


class Refusal(Frozen):
    """A disagreement that was not judged, and why."""

    episode: ShortId
    tick: int = Field(ge=0)
    reason: str


class Change(Frozen):
    """A change of success, as a share of the attempts, with its 95 % interval."""

    estimate: float = Field(ge=-1, le=1)
    low: float = Field(ge=-1, le=1)
    high: float = Field(ge=-1, le=1)


class ShadowRow(Frozen):
    """What was found at the starts of one stratum, or of all ('all')."""

    stratum: str
    attempts: int = Field(ge=0)
    apart: int = Field(ge=0, description="attempts with a lasting disagreement")
    judged: int = Field(ge=0, description="of those; the others were refused, or not drawn")
    right: dict[Right, int] = Field(description="verdict -> disagreements")
    undecided: int = Field(ge=0, description="of the judged: an interval holds one half")
    change: Change | None = Field(default=None, description="expected on promotion; None where nothing was judged")


class FamilyRow(Frozen):
    """How often each policy ended wrong in one way."""

    family: str
    champion: int = Field(ge=0, description="disagreements at which the champion was wrong, mostly so")
    candidate: int = Field(ge=0)


class ShadowReport(Frozen):
    """What would change if the candidate took the champion's place, by what happened at work."""

    run: ShortId
    generation: int = Field(ge=0, description="lap whose deployment was judged")
    twin: int
    champion: ShortId
    candidate: ShortId
    former: bool = Field(description="the candidate has been champion before: to promote it is to roll back")
    ticks: int = Field(gt=0, description="ticks at which both said what to do")
    agreement: float = Field(ge=0, le=1, description="share of ticks with a disagreement below the threshold")
    rows: tuple[ShadowRow, ...] = Field(description="'all' first, then every stratum")
    families: tuple[FamilyRow, ...]
    checked: int = Field(default=0, ge=0, description="attempts that both also played alone from the first tick")
    from_start: Change | None = Field(default=None, description="the change in those attempts, nothing assumed")
    missed: Change | None = Field(default=None, description="in the same attempts: from the start minus judged")
    verdict: Literal["promote", "hold", "roll back"]
    reason: str
    config: JudgeConfig
    estimated: bool = Field(default=False, description="states were estimated from what the robot sensed")
    judgements: tuple[Judgement, ...]
    refusals: tuple[Refusal, ...]

    @property
    def change(self) -> Change | None:
        """The expected change of success on promotion."""
        return self.rows[0].change
