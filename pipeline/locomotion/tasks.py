"""Tasks of legged robots: how attempts start, what pushes them, when they have fallen, and what is rewarded."""

from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Self

from pydantic import Field, model_validator

from pipeline.documents import load_document
from pipeline.errors import unknown
from pipeline.locomotion.rewards import REWARDS
from schemas.base import Frozen

MOST_TERMS = 5


def _common(share: object) -> bool:
    """Kinds of start that are not rare say nothing of it: trainings begun before there were any are found again."""
    return share == 0


def _off(flag: object) -> bool:
    """Tasks that leave this out are those that never had it: their trainings are found again."""
    return flag is False


class Starts(Frozen):
    """One kind of start; every range is drawn evenly, on both sides where it is a limit."""

    tilt_rad: float = Field(default=0.0, ge=0, description="largest lean of the base, in any direction")
    crouch: tuple[float, float] = Field(default=(0.0, 0.0), description="knee bend beyond home, share of what is left")
    joint_rad: float = Field(default=0.0, ge=0, description="largest deviation of a joint from its posture")
    speed_m_s: float = Field(default=0.0, ge=0, description="largest speed of the base over ground, in any direction")
    turn_rad_s: float = Field(default=0.0, ge=0, description="largest turning speed of the base about each axis")
    rare_share: float = Field(default=0.0, ge=0, le=1, exclude_if=_common,
                              description="share of the rare starts; 0 for a common kind")


class Pushes(Frozen):
    """Blows that change the speed of the whole robot at once: impulse divided by mass."""

    speed_m_s: float = Field(default=0.0, ge=0, description="largest change of speed, in any direction over ground")
    every_s: tuple[float, float] = Field(default=(2.0, 4.0), description="time between blows")


class LeggedTask(Frozen):
    """What a legged robot is to do."""

    instruction: str
    seconds: float = Field(default=10.0, gt=0, le=1000)
    control_hz: float = Field(default=50.0, gt=0, le=1000)
    substeps: int = Field(default=4, ge=1, description="steps of the engine in a control period")
    starts: dict[str, Starts] = Field(min_length=1, description="kind of start -> how it is drawn; the first is usual")
    pushes: Pushes = Pushes()
    command: tuple[tuple[float, float], tuple[float, float], tuple[float, float]] = Field(
        default=((0, 0), (0, 0), (0, 0)), description="ranges of speed forward, left [m/s] and turning [rad/s]")
    stride_s: float = Field(default=0.0, ge=0, description="period of the gait's clock; 0 for none")
    solid_feet: bool = Field(default=False, exclude_if=_off,
                             description="feet bump into each other; else they pass through each other")
    fallen_rad: float = Field(default=1.0, description="lean at which an attempt has failed")
    fallen_height: float = Field(default=0.6, description="share of the home height under which it has failed")
    weights: dict[str, float] = Field(min_length=1, description="reward terms of REWARDS, at most five")

    @property
    def ticks(self) -> int:
        """Length of a full attempt [ticks]."""
        return round(self.seconds * self.control_hz)

    def asking(self, forward_m_s: float, left_m_s: float = 0.0, turning_rad_s: float = 0.0) -> Self:
        """The same task with one command for every attempt; the starts stay what they are."""
        speeds = (forward_m_s, left_m_s, turning_rad_s)
        return self.model_copy(update={"command": tuple((v, v) for v in speeds)})

    @property
    def common(self) -> tuple[str, ...]:
        """Kinds of start that are not rare."""
        return tuple(n for n, s in self.starts.items() if s.rare_share == 0)

    @property
    def rare(self) -> dict[str, float]:
        """Rare kinds and their shares among the rare starts."""
        return {n: s.rare_share for n, s in self.starts.items() if s.rare_share > 0}

    @model_validator(mode="after")
    def few_known_terms(self) -> Self:
        """At most five terms, each of them known and of a finite weight."""
        if len(self.weights) > MOST_TERMS:
            raise ValueError(f"{len(self.weights)} reward terms, at most {MOST_TERMS}: join or drop some")
        for name in self.weights:
            if name not in REWARDS:
                raise unknown("reward term", name, REWARDS)
        if not all(map(isfinite, self.weights.values())):
            raise ValueError("every weight is a finite number")
        return self


STAND = LeggedTask(
    instruction="Stand, whatever pushes you.",
    starts={"leaning": Starts(tilt_rad=0.15, crouch=(0.0, 0.6), joint_rad=0.15, speed_m_s=0.3, turn_rad_s=0.4),
            "thrown": Starts(tilt_rad=0.25, crouch=(0.0, 0.6), joint_rad=0.15, speed_m_s=0.5, turn_rad_s=0.7)},
    pushes=Pushes(speed_m_s=0.5),
    weights={"upright": 1.0, "height": 0.5, "still": 0.5, "posture": 0.3, "effort": -0.3})

BALANCE = STAND.model_copy(update={
    "instruction": "Keep your balance, whatever comes.", "seconds": 6.0,
    "starts": {"leaning": STAND.starts["leaning"],
               "hurled": Starts(tilt_rad=0.25, crouch=(0.0, 0.6), joint_rad=0.15, speed_m_s=0.8, turn_rad_s=0.8,
                                rare_share=0.5),
               "deep": Starts(tilt_rad=0.15, crouch=(0.7, 1.1), joint_rad=0.15, speed_m_s=0.4, turn_rad_s=0.5,
                              rare_share=0.5)},
    "pushes": Pushes(speed_m_s=0.45, every_s=(1.2, 2.8))})
"""As STAND, met with starts at work that nobody foresaw: training draws the common kind alone."""

WALK = LeggedTask(
    instruction="Walk at the speed that you are told.",
    starts={"standing": Starts(tilt_rad=0.05, joint_rad=0.05, speed_m_s=0.1)},
    command=((0.0, 0.8), (0.0, 0.0), (0.0, 0.0)), stride_s=0.7, solid_feet=True,
    weights={"velocity": 1.5, "heading": 1.0, "upright": 0.5, "gait": 1.2, "smooth": -0.05})

LEGGED_TASKS: MappingProxyType[str, LeggedTask] = MappingProxyType({"stand": STAND, "balance": BALANCE, "walk": WALK})
"""Task name -> its config. Add one: a LeggedTask, and an entry here."""


def load_legged_task(name: str) -> LeggedTask:
    """The task of that name, or the one in that YAML file; ConfigError lists the names, or the field that is wrong."""
    if name in LEGGED_TASKS:
        return LEGGED_TASKS[name]
    if name.endswith((".yaml", ".yml")):
        return load_document(Path(name), LeggedTask, kind="a task", example="fields: pipeline/locomotion/tasks.py")
    raise unknown("task", name, [*LEGGED_TASKS, "PATH.yaml"])
