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

    @property
    def deploys(self) -> bool:
        """Whether this arm spends robot time on deployments."""
        return self.new_data in ("corrections", "failed-starts")

    def recipe(self, recipe: Recipe) -> Recipe:
        """The recipe as this arm runs it."""
        return recipe.model_copy(update={
            "harvest": recipe.harvest.model_copy(update={"oracle": self.oracle}),
            "dataset": recipe.dataset.model_copy(update={"sources": (*recipe.dataset.sources, "oracle")}),
        }) if self.oracle else recipe


LOOP = ""

ARMS: MappingProxyType[str, Arm] = MappingProxyType({
    LOOP: Arm("the loop: corrections of harvested failures"),
    "random": Arm("as many demonstrations at random starts", new_data="random"),
    "random-seconds": Arm("demonstrations at random starts for the same robot seconds, deployment included",
                          new_data="random-seconds"),
    "failed-starts": Arm("whole demonstrations at the starts that failed", new_data="failed-starts"),
    "whole-workspace": Arm("retargeting over the whole workspace, no new data", new_data="none",
                           whole_workspace=True),
    "oracle": Arm("oracle: rewinds and corrects from true state", oracle=True),
})
"""Name of the arm -> what it does; the empty name is the loop itself."""


def arm_of(name: str) -> Arm:
    """The arm of that name; ConfigError lists the valid ones."""
    if name not in ARMS:
        raise unknown("arm", name, [a for a in ARMS if a])
    return ARMS[name]
