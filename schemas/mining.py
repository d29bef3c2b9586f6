"""Family, Ranked, RegressionScene: ways of failing that were found, the queue of corrections, and what stays fixed."""

from typing import Self

from pydantic import Field, model_validator

from schemas.base import Frozen, Name, ShortId
from schemas.scene import SceneSpec


class Family(Frozen):
    """Failures that went alike; found once, and joined by later ones from lap to lap."""

    id: ShortId = Field(description="follows from run and medoid")
    name: Name = Field(description="subtask that was not finished, and the signs that stood out; unique in a run")
    medoid: ShortId = Field(description="episode of the failure that is most like all others of the first lap")
    says: str = Field(description="what happened in it, with numbers")
    subtask: str
    generation: int = Field(ge=0, description="lap in which it was new")
    point: dict[str, float] = Field(description="features of the medoid, each over its scale")


class Ranked(Frozen):
    """One place in the queue of corrections."""

    case: ShortId
    episode: ShortId
    family: ShortId
    worth: float = Field(ge=0, description="failures of this deployment that its correction is expected to end, beyond "
                                           "those of the corrections before it")
    per_1000: float = Field(ge=0, description="the same for 1,000 attempts at work")
    again: float = Field(ge=0, le=1, description="share of failures among the attempts that began like it: what fails "
                                                 "once where others succeed is an accident")
    chance: float = Field(ge=0, le=1, description="that a correction ends failures of this family, as laps have shown")
    novelty: float = Field(ge=0, le=1, description="part that nothing which was taught before reaches")
    folds: tuple[ShortId, ...] = Field(default=(), description="near-duplicates that it stands for")
    reason: str


class RegressionScene(Frozen):
    """The start of a hard case that a release solved: no later one may lose it without saying so."""

    id: ShortId = Field(description="follows from the hard case")
    hard_case: ShortId
    episode: ShortId = Field(description="the attempt that failed")
    family: str = Field(description="name of its failure family")
    scene: SceneSpec = Field(description="as its robot perceived it; physics are drawn when it is played")
    fixed_by: ShortId = Field(description="the released policy that first solved it")
    generation: int = Field(ge=0, description="lap of that release")
    solved: int = Field(ge=0, description="of `played` times")
    played: int = Field(ge=1)

    @model_validator(mode="after")
    def nothing_of_the_twin_is_in_it(self) -> Self:
        """It is played in the training-side simulation."""
        if self.scene.twin is not None or self.scene.draws:
            raise ValueError(f"scene of twin {self.scene.twin} with {len(self.scene.draws)} draws: a regression scene "
                             "is the perceived start alone")
        return self
