"""SceneSpec: everything that decides how one attempt starts, before anybody acts."""

from typing import Literal

from pydantic import Field

from schemas.base import Frozen, Name

type SceneFamily = Literal["demo", "augment", "gate", "deploy", "exam", "study", "teleop"]


class Draw(Frozen):
    """What one randomization chose, kept in the provenance of whatever used it."""

    name: str
    unit: str
    value: float


class SceneSpec(Frozen):
    """The start of one attempt: who, where, what, and the physics drawn for it.

    The seed also drives perception noise and delay jitter, tick by tick, so that
    a scene played twice under the same commands gives the same bits.
    """

    family: SceneFamily = Field(description="seed family; families never share a seed")
    seed: int = Field(ge=0)
    robot: Name
    scene: Name
    task: Name
    stratum: Name = Field(description="kind of start: common, beside, large, ...")
    object_xy_m: tuple[float, float]
    object_yaw_rad: float
    object_half_m: float = Field(gt=0, description="half edge of the cube [m]")
    target_xy_m: tuple[float, float]
    draws: tuple[Draw, ...] = Field(default=(), description="randomized physics; empty means nominal, or a twin's own")
    twin: int | None = Field(default=None, description="seed of the twin whose hidden physics apply")
