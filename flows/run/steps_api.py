"""What the flow asks of the stages: the seam between `when` (flows) and `what` (stages and store)."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from schemas.recipe import Recipe
from schemas.summary import LoopResult
from schemas.verdict import Verdict

type Progress = Callable[[int, int], None]
"""(done, total) of the running stage, in whatever the stage counts; cheap enough to call every batch."""

STAGES: tuple[str, ...] = (
    "collect",
    "augment",
    "build",
    "train",
    "gate",
    "release",
    "exam",
    "deploy",
    "harvest",
    "judge",
    "worth",
    "report",
)
"""Every stage, in the order of a lap; judge and worth follow the last one."""


@dataclass(frozen=True, slots=True)
class StepResult:
    """What a finished stage says of itself: ids and one line, never data."""

    ids: tuple[str, ...]
    """What it made: episodes, a version, a policy, a verdict, hard cases, or the path of the report."""
    says: str
    """One short line for people: '48 of 50 demonstrations kept'."""
    resumed: bool = False
    """True if the store's manifest said finished and nothing was done again."""


class LoopSteps(Protocol):
    """The stages of one run, wired to its store.

    Every stage is idempotent: it asks the store's manifest of (run, generation,
    stage) first and hands back what that says if it is finished. A stage that
    fails or is interrupted leaves no manifest and is begun again.
    """

    @property
    def run(self) -> str:
        """Id of this run."""
        ...

    @property
    def recipe(self) -> Recipe:
        """The numbers of this run."""
        ...

    @property
    def control(self) -> "LoopSteps | None":
        """The same loop with random starts in place of the harvest, beside this one; None unless asked for."""
        ...

    day: int | None
    """Number of the day of a run by the clock, whose nights share an error budget; None by hand [d]."""

    def tonight(self) -> int:
        """The lap that a night turns: the first one that has not sat its exam."""
        ...

    def current(self, stage: str) -> int:
        """Generation at which `stage` runs next, or the last one where it is finished everywhere."""
        ...

    def collect(self, generation: int, progress: Progress) -> StepResult:
        """Scripted demonstrations; only generation 0 has any."""
        ...

    def augment(self, generation: int, progress: Progress) -> StepResult:
        """Variants of what is new: demonstrations, later corrections."""
        ...

    def build(self, generation: int, progress: Progress) -> StepResult:
        """The dataset version of this generation."""
        ...

    def train(self, generation: int, progress: Progress) -> StepResult:
        """The candidate policy."""
        ...

    def gate(self, generation: int, progress: Progress) -> StepResult:
        """Candidate against champion; `ids` is the verdict."""
        ...

    def release(self, generation: int, progress: Progress) -> StepResult:
        """Move the champion pointer if the verdict says so; `ids` is the champion afterwards."""
        ...

    def exam(self, generation: int, progress: Progress) -> StepResult:
        """The champion on the twin starts that no decision reads."""
        ...

    def deploy(self, generation: int, progress: Progress) -> StepResult:
        """The champion on the twin: the only source of harvest."""
        ...

    def harvest(self, generation: int, progress: Progress) -> StepResult:
        """Hard cases of this deployment and their corrections."""
        ...

    def judge(self, generation: int, progress: Progress) -> StepResult:
        """Who was right where the newest candidate would have acted otherwise in the last deployment."""
        ...

    def worth(self, generation: int, progress: Progress) -> StepResult:
        """What the last lap's new episodes were worth, by one extra training."""
        ...

    def report(self, progress: Progress) -> StepResult:
        """The HTML page; `ids` is its path."""
        ...

    def rollback(self) -> StepResult:
        """Move the champion pointer back to the policy before it, by a release with a new number."""
        ...

    def result(self) -> LoopResult:
        """The numbers so far; wall time and memory are those of the process that asks."""
        ...

    def last_verdict(self) -> Verdict | None:
        """The newest verdict of this run."""
        ...

    def report_path(self) -> Path | None:
        """The newest report, if one was written."""
        ...
