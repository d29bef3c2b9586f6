"""What a finished loop says of itself: the machine-readable result and the numbers of the report."""

from pydantic import Field

from schemas.base import Frozen, ShortId
from schemas.verdict import Proportion


class GateLine(Frozen):
    """The gate in one line."""

    verdict: str
    p: float | None


class Generation(Frozen):
    """One lap: success is the exam of that generation's champion."""

    generation: int
    dataset_version: ShortId
    policy: ShortId = Field(description="champion after this generation's gate")
    success: dict[str, Proportion] = Field(description="all, common, rare, deployment_mix")
    gate: GateLine
    robot_s: float = Field(description="robot time deployed so far, corrections included [s]")
    corrections: int = Field(description="corrections asked for so far")
    wall_s: dict[str, float] = Field(description="stage -> wall seconds of this lap")


class Paired(Frozen):
    """Generation 0 against the last, on the same exam scenes; it speaks of this pair and nothing more."""

    fixed: int
    broken: int
    p: float


class ShadowLine(Frozen):
    """Who was right where the newest candidate would have acted otherwise than the champion last at work."""

    champion: ShortId
    candidate: ShortId
    agreement: float = Field(description="share of ticks at which both said nearly the same")
    attempts: int
    apart: int = Field(description="attempts with a lasting disagreement")
    judged: int = Field(description="of those: played on from the moment by both policies")
    right: dict[str, int] = Field(description="champion, candidate, both, neither -> disagreements")
    undecided: int
    change: tuple[float, float, float] | None = Field(
        description="expected change of success on promotion with its 95 % limits; None where nothing was judged")
    verdict: str

    @property
    def says(self) -> str:
        """'candidate differs in 12 of 150 attempts: right 5, champion 1, both 4, neither 2; promotion +2.7 points'."""
        named = ", ".join(f"{who} {n}" for who, n in self.right.items() if n) or "none judged"
        line = f"candidate and champion apart in {self.apart} of {self.attempts} attempts; right: {named}"
        if self.change is None:
            return line
        estimate, low, high = (100 * value for value in self.change)
        return f"{line}; promotion {estimate:+.1f} points [{low:+.1f} {high:+.1f}], {self.verdict}"


class WorthLine(Frozen):
    """What the new episodes of the last lap that had any were worth by so many trainings."""

    generation: int = Field(description="lap that added them")
    batch: str
    episodes: int
    points: float = Field(description="success with the batch minus success without it, percentage points")
    seeds: int
    scenes: int
    kinds: dict[str, float] = Field(description="kind of start -> points")

    @property
    def says(self) -> str:
        """'+3.5 points by the 46 episodes of lap 2 on 200 scenes (common +0.0, beside +9.1); 1 seed, indicative'."""
        kinds = ", ".join(f"{name} {points:+.1f}" for name, points in self.kinds.items())
        seeds = f"{self.seeds} seed{'s' * (self.seeds != 1)}"
        return (f"{self.points:+.1f} points by the {self.episodes} episodes of lap {self.generation} "
                f"on {self.scenes} scenes"
                f"{f' ({kinds})' if kinds else ''}; {seeds}, indicative")


class LoopResult(Frozen):
    """Written by --json."""

    generations: tuple[Generation, ...]
    control: tuple[Generation, ...] | None = None
    paired: Paired
    wall_s: float
    peak_pss_mb: float
    seed: int
    twin: int
    shadow: ShadowLine | None = None
    worth: WorthLine | None = None


class AugmentReport(Frozen):
    """What one augmentation made and what the filter kept."""

    tried: dict[str, int] = Field(description="transform -> variants tried")
    kept: dict[str, int]
    survival: dict[str, float] = Field(description="demonstration id -> share of its variants that succeeded")
    coverage_before: float = Field(description="share of 2 cm workspace cells with a start, before")
    coverage_after: float


class TriggerReport(Frozen):
    """Sensor-side failure labels of one deployment against the truth that no decision reads."""

    precision: float | None
    recall: float | None
    flagged: int
    failed: int
    by_trigger: dict[str, int]
    by_family: dict[str, int]


class Lap(Frozen):
    """The numbers of one generation that only the report needs."""

    generation: int
    augment: AugmentReport | None = None
    triggers: TriggerReport | None = None
    exam_strata: dict[str, Proportion] = Field(default={})
    candidate_exam: Proportion | None = Field(default=None, description="exam of the candidate, released or not")
    rewards: dict[str, tuple[float, ...]] = Field(default={}, description="reward term -> mean by tick over the exam")
    correction_success: Proportion | None = None
    frames_by_source: dict[str, int] = Field(default={})
    shadow_disagreement: tuple[float, float] | None = Field(default=None, description="mean on successes, on failures")
    signals: dict[str, dict[str, tuple[float | None, ...]]] = Field(
        default={}, description="signal of risk -> 'success' or 'failure' -> mean by tick over the deployed attempts")
