"""LeggedStart: how one attempt of a legged robot begins, as plain data."""

from typing import Self

from pydantic import Field, model_validator

from schemas.base import Frozen

UNIT_WITHIN = 1e-3


class LeggedStart(Frozen):
    """A legged robot before anybody acts, and what will push it."""

    height_m: float = Field(gt=0, description="of the base [m]")
    quaternion: tuple[float, float, float, float] = Field(description="orientation of the base w, x, y, z")
    velocity: tuple[float, float, float, float, float, float] = Field(
        description="of the base: over ground [m/s], then about its own axes [rad/s]")
    bend: tuple[float, ...] = Field(min_length=1, description="deviation of the joints from home [rad]")
    rates: tuple[float, ...] = Field(default=(), description="speeds of the joints [rad/s]; empty: all stand still")
    command: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="speed asked for: forward, left [m/s], turning [rad/s]")
    blows: tuple[tuple[int, float, float], ...] = Field(
        default=(), description="tick, and change of speed over ground [m/s]")

    @model_validator(mode="after")
    def whole(self) -> Self:
        """The quaternion is one, joint speeds are given for all joints or none, blows come one after the other."""
        if abs(sum(v * v for v in self.quaternion) - 1) > UNIT_WITHIN:
            raise ValueError(f"quaternion {self.quaternion} is not of length 1")
        if self.rates and len(self.rates) != len(self.bend):
            raise ValueError(f"{len(self.rates)} joint speeds for {len(self.bend)} joints: give all or none")
        ticks = [tick for tick, *_ in self.blows]
        if ticks != sorted(ticks) or min(ticks, default=0) < 0:
            raise ValueError(f"blows at ticks {ticks}: give them in order, from tick 0 on")
        return self
