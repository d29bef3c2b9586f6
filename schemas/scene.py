"""SceneSpec: everything that decides how one attempt starts, before anybody acts."""

from typing import Literal, Self

from pydantic import Field, model_validator

from schemas.base import Frozen, Name
from schemas.legged import LeggedStart

type SceneFamily = Literal["demo", "augment", "gate", "deploy", "exam", "study", "teleop", "foreign", "selection",
                           "regression"]


def _not_legged(start: object) -> bool:
    """Scenes of other robots say nothing of it: their ids stay as they were."""
    return start is None


class Draw(Frozen):
    """What one randomization chose, kept in the provenance of whatever used it."""

    name: str
    unit: str
    value: float


class SceneSpec(Frozen):
    """The start of one attempt: who, where, what, and the physics drawn for it.

    The seed also drives perception noise and delay jitter, tick by tick, so that
    a scene played twice under the same commands gives the same bits. Of an attempt in a 'foreign' log
    nothing but robot and task is known: its numbers are 0, and its seed only tells one start from another.
    A legged robot works on nothing: the numbers of object and target are 0, and `legged` tells how it begins.
    """

    family: SceneFamily = Field(description="seed family; families never share a seed")
    seed: int = Field(ge=0)
    robot: Name
    scene: Name
    task: Name
    stratum: Name = Field(description="kind of start: common, beside, large, ...")
    object_xy_m: tuple[float, float]
    object_yaw_rad: float
    object_half_m: float = Field(ge=0, description="half edge of the cube [m]; 0 where no cube is")
    target_xy_m: tuple[float, float]
    draws: tuple[Draw, ...] = Field(default=(), description="randomized physics; empty means nominal, or a twin's own")
    twin: int | None = Field(default=None, description="seed of the twin whose hidden physics apply")
    legged: LeggedStart | None = Field(default=None, exclude_if=_not_legged,
                                       description="start of a legged robot; such a scene has no cube")

    @model_validator(mode="after")
    def only_foreign_and_legged_scenes_have_no_cube(self) -> Self:
        """Every other scene of ours has a cube of some size."""
        if (self.object_half_m == 0) != (self.family == "foreign" or self.legged is not None):
            raise ValueError(f"object_half_m = {self.object_half_m} in a scene of family {self.family!r}: exactly "
                             "'foreign' and legged scenes have none")
        return self
