"""HardCase: a failure worth learning from, whole and restorable."""

from pydantic import Field

from schemas.base import Frozen, ShortId
from schemas.counterfactual import Judgement, Wrong
from schemas.legged import LeggedStart


def _not_mined(value: object) -> bool:
    """Nor about families, before they were looked for."""
    return value is None


def _not_judged(value: object) -> bool:
    """A case that no judgement made says nothing about judgements, as before there were any."""
    return value is None


class HardCase(Frozen):
    """A deployed attempt that a trigger stopped, or a moment at which a policy was judged wrong; what became of it."""

    id: ShortId
    episode: ShortId
    trigger: str = Field(description="what noticed it; 'disagreement' where two policies were judged")
    tick: int = Field(description="tick of the trigger, or at which the disagreement begins")
    family: str
    stratum: str
    generation: int
    correction: ShortId | None = None
    corrected: bool = False
    wrong: Wrong | None = Field(default=None, exclude_if=_not_judged, description="who was wrong there for certain")
    judgement: Judgement | None = Field(
        default=None, exclude_if=_not_judged, description="both policies, their draws, and why the wrong one failed")
    found: ShortId | None = Field(default=None, exclude_if=_not_mined, description="failure family that it was found "
                                  "to belong to, whatever trigger noticed it")
    subtask: str | None = Field(default=None, exclude_if=_not_mined, description="the first that was not finished")
    begins: int | None = Field(default=None, ge=0, exclude_if=_not_mined, description="tick at which that began")
    start: LeggedStart | None = Field(default=None, exclude_if=_not_mined, description="legged robots: the state some "
                                      "time before the fall, as sensed; what a later training may begin at")
