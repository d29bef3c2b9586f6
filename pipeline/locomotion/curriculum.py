"""Curriculum: where the attempts of a training begin: kinds of start that are drawn, and states before falls."""

from dataclasses import replace
from typing import TYPE_CHECKING, Self

import numpy as np
from pydantic import Field, model_validator

from pipeline.locomotion.starts import Start, draw_start, from_data, pushed
from pipeline.protocols import Array
from schemas.base import Frozen, ShortId
from schemas.legged import LeggedStart

if TYPE_CHECKING:
    from pipeline.locomotion.body import LeggedBody
    from pipeline.locomotion.tasks import LeggedTask

LEAN_RAD, BEND_RAD, SPEED_M_S, TURN_RAD_S = 0.03, 0.05, 0.1, 0.2
"""Standard deviations of a start spread about a hard one, for a spread of 1."""
CHOOSES = 73
"""Word that keeps the choice of a start apart from what is drawn for it."""


class HardStart(Frozen):
    """Where a robot stood some time before it fell, as it sensed it."""

    case: ShortId = Field(description="hard case of the fall")
    episode: ShortId
    family: str = Field(description="of the fall")
    generation: int = Field(ge=0, description="lap whose deployment it fell in")
    weight: float = Field(default=1.0, gt=0, description="chance beside the others'")
    start: LeggedStart


class Curriculum(Frozen):
    """Shares of the attempts by where they begin; everything follows from a start's seed."""

    kinds: dict[str, float] = Field(min_length=1, description="kind of start -> weight among those that are drawn")
    hard_share: float = Field(default=0.0, ge=0, lt=1, description="share that begins at hard starts; 0 without any")
    spread: float = Field(default=0.0, ge=0, description="how far attempts are spread about a hard start, see "
                                                         "spread_about")
    starts: tuple[HardStart, ...] = ()

    @model_validator(mode="after")
    def shares_have_what_they_share(self) -> Self:
        """Weights are above 0, and hard starts have a share exactly where there are some."""
        if min(self.kinds.values()) <= 0:
            raise ValueError(f"kinds {self.kinds}: every weight must be above 0")
        if (self.hard_share > 0) != bool(self.starts):
            raise ValueError(f"hard_share {self.hard_share} with {len(self.starts)} hard starts: give both or none")
        return self


class StartSource:
    """A curriculum ready to be drawn from, for one task and body.

    Args:
        curriculum: the shares.
        task, body: what the attempts are of.
    """

    def __init__(self, curriculum: Curriculum, task: "LeggedTask", body: "LeggedBody") -> None:
        self._task, self._body, self._curriculum = task, body, curriculum
        self._kinds: list[str] = [*curriculum.kinds]
        self._kind_edges: Array = _edges([*curriculum.kinds.values()])
        self._hard = [from_data(h.start) for h in curriculum.starts]
        self._hard_edges: Array = _edges([h.weight for h in curriculum.starts])

    def draw(self, seed: int) -> Start:
        """The start that this seed gives: a hard one with blows of its own, or one of a drawn kind."""
        rng = np.random.default_rng([seed, CHOOSES])
        hard, which = rng.uniform(size=2)
        if hard < self._curriculum.hard_share:
            found = self._hard[_part(self._hard_edges, which)]
            return pushed(spread_about(found, self._curriculum.spread, rng), self._task, seed)
        kind = self._kinds[_part(self._kind_edges, which)]
        return draw_start(self._task, self._body, kind, seed)


def spread_about(start: Start, spread: float, rng: np.random.Generator) -> Start:
    """A start near another: lean and joints, speeds of the base and of the joints vary, heading and height do not.

    Args:
        start: the one in the middle.
        spread: 1 is 0.03 rad of lean about each horizontal axis, 0.05 rad a joint, 0.1 m/s and 0.2 rad/s, as standard
            deviations.
        rng: the only source of randomness.
    """
    if not spread:
        return start
    lean = spread * LEAN_RAD * rng.normal(size=2)
    velocity = start.velocity + spread * rng.normal(size=6) * np.repeat([SPEED_M_S, TURN_RAD_S], 3)
    bend = start.bend + spread * BEND_RAD * rng.normal(size=start.bend.shape)
    rates = None if start.rates is None else start.rates + spread * TURN_RAD_S * rng.normal(size=start.rates.shape)
    return replace(start, quaternion=_leant(start.quaternion, lean), velocity=velocity, bend=bend, rates=rates)


def _leant(quaternion: Array, lean: Array) -> Array:
    """The orientation leant further about the world's x and y axes by small angles [rad]."""
    w, x, y, z = quaternion
    a, b = lean / 2
    turned = np.array([w - a * x - b * y, x + a * w + b * z, y + b * w - a * z, z + a * y - b * x])
    return turned / np.linalg.norm(turned)


def _edges(weights: list[float]) -> Array:
    """Upper limits of each one's part of [0, 1), without the last."""
    return np.cumsum(weights)[:-1] / sum(weights) if weights else np.zeros(0)


def _part(edges: Array, at: float) -> int:
    """Whose part a number in [0, 1) lies in."""
    return int((edges <= at).sum())
