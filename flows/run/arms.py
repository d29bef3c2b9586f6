"""Arms: the loop, and what it is compared with. Each learns from the same number of new episodes, said where not."""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from pipeline.errors import unknown
from schemas.recipe import Recipe


@dataclass(frozen=True, slots=True)
class Arm:
    """What one arm does differently from the loop."""

    says: str
    """One line for the table of a study."""
    new_data: Literal["corrections", "random", "random-seconds", "failed-starts", "none"] = "corrections"
    whole_workspace: bool = False
    """Retargeting aims at every kind of start, from generation 0 on."""
    oracle: bool = False
    widen: float | None = None
    """Factor on the width of every randomization."""
    keep_rejected: bool = False

    @property
    def deploys(self) -> bool:
        """Whether this arm spends robot time on deployments."""
        return self.new_data in ("corrections", "failed-starts")

    def recipe(self, recipe: Recipe) -> Recipe:
        """The recipe as this arm runs it."""
        changes: dict[str, object] = {}
        if self.oracle:
            changes["harvest"] = recipe.harvest.model_copy(update={"oracle": True})
            sources = (*recipe.dataset.sources, "oracle")
            changes["dataset"] = recipe.dataset.model_copy(update={"sources": sources})
        if self.widen is not None:
            wide = {"widen": self.widen, "keep_rejected": self.keep_rejected}
            changes["augment"] = recipe.augment.model_copy(update=wide)
        return recipe.model_copy(update=changes) if changes else recipe


LOOP = ""

ARMS: MappingProxyType[str, Arm] = MappingProxyType({
    LOOP: Arm("the loop: corrections of harvested failures"),
    "random": Arm("as many demonstrations at random starts", new_data="random"),
    "random-seconds": Arm("demonstrations at random starts for the same robot seconds, deployment included",
                          new_data="random-seconds"),
    "failed-starts": Arm("whole demonstrations at the starts that failed", new_data="failed-starts"),
    "whole-workspace": Arm("retargeting over the whole workspace, no new data", new_data="none",
                           whole_workspace=True),
    "wide": Arm("randomization 2.5 times as wide, no new data", new_data="none", widen=2.5),
    "wide-unfiltered": Arm("the same with the rejected variants left in", new_data="none", widen=2.5,
                           keep_rejected=True),
    "oracle": Arm("oracle: rewinds and corrects from true state", oracle=True),
})
"""Name of the arm -> what it does; the empty name is the loop itself."""


def arm_of(name: str) -> Arm:
    """The arm of that name; ConfigError lists the valid ones."""
    if name not in ARMS:
        raise unknown("arm", name, [a for a in ARMS if a])
    return ARMS[name]
