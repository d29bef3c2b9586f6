"""Episode, its Segments and its Outcome: the unit that travels the loop."""

from typing import Literal, Self

from pydantic import Field, model_validator

from schemas.base import Frozen, Sha256, ShortId
from schemas.consent import SIMULATED
from schemas.scene import SceneSpec

type Origin = Literal["scripted", "teleop", "replayed", "retargeted", "deployed", "corrected", "oracle",
                      "ingested", "imported"]

VARIANTS: tuple[Origin, ...] = ("replayed", "retargeted")
WITH_PARENT: tuple[Origin, ...] = ("replayed", "retargeted", "corrected", "oracle")


class Segment(Frozen):
    """Frames [start, stop) of an episode that one party commanded."""

    kind: Literal["demonstration", "autonomous", "intervention"]
    start: int = Field(ge=0)
    stop: int = Field(gt=0)
    actor: str = Field(description="policy id, 'expert', or an operator's pseudonym")

    @model_validator(mode="after")
    def segments_are_not_empty(self) -> Self:
        """A segment holds at least one frame."""
        if self.stop <= self.start:
            raise ValueError(f"segment [{self.start}, {self.stop}) is empty")
        return self


class Outcome(Frozen):
    """How an attempt ended, by what the robot can sense; truth only where a simulator judged."""

    label: Literal["success", "failure", "unknown"]
    judged_by: Literal["simulator", "sensors", "operator"]
    trigger: str | None = Field(default=None, description="name of the trigger that fired first")
    family: str | None = Field(default=None, description="failure family; None for a success")
    tick: int | None = Field(default=None, ge=0, description="tick at which the trigger fired")
    reason: str | None = None


class Episode(Frozen):
    """One attempt at one task by one robot."""

    id: ShortId
    origin: Origin
    scene: SceneSpec
    control_hz: float = Field(gt=0, le=1000, description="rate of the action stream [Hz]")
    frames: int = Field(gt=0)
    outcome: Outcome
    segments: tuple[Segment, ...]
    parent: ShortId | None = Field(default=None, description="episode this one was made from")
    transform: str | None = Field(default=None, description="how it was made from its parent, or from a foreign log")
    policy: ShortId | None = Field(default=None, description="policy that acted, if one did")
    generation: int = Field(ge=0)
    blob: Sha256 | None = Field(default=None, description="the MCAP recording, or the shard of variant frames")
    consent: str = Field(default=SIMULATED, description="id of a Consent; 'simulated' where no person was recorded, "
                                                        "'none' where one was and gave none")

    @property
    def duration_s(self) -> float:
        """Length of the attempt [s]."""
        return self.frames / self.control_hz

    @property
    def lineage(self) -> str:
        """Id that a demonstration shares with everything made from it: the unit of the split."""
        return self.parent or self.id

    @model_validator(mode="after")
    def derived_episodes_name_their_parent(self) -> Self:
        """Variants and corrections name a parent, nothing else does."""
        if (self.origin in WITH_PARENT) != (self.parent is not None):
            raise ValueError(f"origin={self.origin!r} with parent={self.parent!r}: exactly {WITH_PARENT} name a parent")
        return self

    @model_validator(mode="after")
    def segments_cover_the_episode(self) -> Self:
        """Segments are in order, without gap or overlap, from the first frame to the last."""
        edges = [0, *(s.stop for s in self.segments)]
        if [s.start for s in self.segments] != edges[:-1] or edges[-1] != self.frames:
            raise ValueError(f"segments {self.segments} do not cover frames 0..{self.frames}")
        return self
