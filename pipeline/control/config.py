"""HierarchyConfig: which robot, which parts, at which rates; changing a part changes one word."""

from math import isclose
from typing import Self

from pydantic import Field, model_validator

from pipeline.errors import ConfigError
from schemas.base import Frozen


class SamplingConfig(Frozen):
    """Predictive sampling (Howell et al. 2022, arXiv 2212.00541, section 4.1); the numbers are those of the arm."""

    samples: int = Field(default=16, ge=2, le=4096, description="plans that are tried each time, the last one included")
    horizon_s: float = Field(default=0.25, gt=0, le=10, description="how far a plan looks ahead [s]")
    knots: int = Field(default=1, ge=1, le=64, description="points of a plan's spline; with 1 it holds one action")
    plan_hz: float = Field(default=50.0, gt=0, description="how often is planned anew [Hz]")
    step_s: float = Field(default=0.01, gt=0, le=0.1, description="time between actions of a plan [s]; for the arm the "
                                                                 "engine's step in plans, too")
    noise: float = Field(default=0.5, gt=0, description="standard deviation of the widest sample, in units of actions")
    narrowest: float = Field(default=0.01, gt=0, le=1, description="that of the narrowest one, as a share; between "
                                                                  "them evenly by ratio, 1 for all alike")

    @property
    def steps(self) -> int:
        """Actions of a plan."""
        return max(1, round(self.horizon_s / self.step_s))


LEGGED_SAMPLING = SamplingConfig(samples=16, horizon_s=0.6, knots=2, plan_hz=50, step_s=0.02, noise=0.5, narrowest=0.1)
"""Numbers of the biped."""


class IkConfig(Frozen):
    """Inverse kinematics: the pose that is solved for runs ahead of the hand."""

    speed_m_s: float = Field(default=1.5, gt=0, description="of the pose that is solved for [m/s]")
    turn_rad_s: float = Field(default=6.0, gt=0, description="the same for its yaw [rad/s]")


class CourseConfig(Frozen):
    """What a legged robot is to do, for the uppers `profile` and `waypoints`."""

    profile: tuple[tuple[float, float], ...] = Field(
        default=((0, 0), (2, 0), (2.5, 0.3), (6, 0.3), (6.5, 0.6), (10, 0.6), (11, 0), (13, 0)), min_length=1,
        description="times, rising [s], and the forward speed asked for then [m/s]; even between them")
    waypoints: tuple[tuple[float, float], ...] = Field(
        default=((1.5, 0.0), (3.0, 1.0), (1.5, 2.0), (0.0, 2.0)), min_length=1,
        description="where to, one after the other, forward and left of where the robot begins [m]")
    speed_m_s: float = Field(default=0.5, gt=0, description="largest between waypoints [m/s]")
    turn_rad_s: float = Field(default=0.4, ge=0, description="fastest turn asked for [rad/s]")
    turn_1_s: float = Field(default=1.5, ge=0, description="turn asked for, a share of the missing angle [1/s]")
    within_m: float = Field(default=0.2, gt=0, description="distance at which a waypoint counts as reached [m]")


class HierarchyConfig(Frozen):
    """One hierarchy: each part is one word."""

    robot: str = Field(default="arm", description="arm; or a legged body: key of LEGGED, or a path")
    upper: str = Field(default="target", description="key of ARM_UPPERS or LEGGED_UPPERS")
    lower: str = Field(default="ik", description="key of ARM_LOWERS or LEGGED_LOWERS")
    upper_hz: float = Field(default=10.0, gt=0, description="how often is commanded [Hz]")
    lower_hz: float = Field(default=100.0, gt=0, description="how often is acted [Hz]")
    seed: int = Field(default=0, ge=0, description="of what the parts draw")
    integral_1_s: float = Field(default=0.0, ge=0, le=20, description="arm: how fast a standing error of the hand is "
                                                                     "added to the command, for any lower [1/s]")
    ik: IkConfig = IkConfig()
    sampling: SamplingConfig = SamplingConfig()
    course: CourseConfig = CourseConfig()
    policy: str | None = Field(default=None, description="legged: ONNX file of the lower `policy`")

    @model_validator(mode="after")
    def rates_divide(self) -> Self:
        """Each rate is a whole share of the one below it."""
        periods(self.lower_hz, self.upper_hz, "upper_hz")
        if self.lower == "mpc":
            periods(self.lower_hz, self.sampling.plan_hz, "sampling.plan_hz")
        return self


def periods(fast_hz: float, slow_hz: float, name: str) -> int:
    """How many periods of the faster clock one of the slower has; ConfigError where that is no whole number."""
    ratio = fast_hz / slow_hz
    if ratio < 1 - 1e-9 or not isclose(ratio, round(ratio), rel_tol=1e-9):
        near = fast_hz / max(1, round(ratio))
        raise ConfigError(f"{slow_hz:g} Hz is no whole share of {fast_hz:g} Hz", where=name,
                          mend=f"set {name} to {fast_hz:g} divided by a whole number, such as {near:.6g}")
    return round(ratio)
