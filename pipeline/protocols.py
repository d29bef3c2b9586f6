"""What a robot, a policy, a trigger and a recorder must be able to do: the seams of the loop."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pipeline.triggers import Senses

type Array = NDArray[np.float64]
type Ids = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Observation:
    """What n robots perceive at one tick; rows belong to the ids they were asked for."""

    state: Array
    """See pipeline.frames.STATE, shape (n, 16)."""
    environment: Array
    """See pipeline.frames.ENVIRONMENT, shape (n, 7)."""


class Policy(Protocol):
    """Maps observations of n attempts to actions; may keep a memory per attempt."""

    def reset(self, n: int) -> None:
        """Forget everything and prepare for n attempts."""
        ...

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Actions (len(ids), 5) in the order of ids; see pipeline.frames.ACTION."""
        ...

    def memory(self, ids: Ids) -> Array:
        """The memory of the attempts as rows (len(ids), w), w may be 0: part of a restorable state."""
        ...


class Robot(Protocol):
    """n robots side by side, real or simulated, that act and perceive on one control clock."""

    control_hz: float

    def observe(self, ids: Ids) -> Observation:
        """What the robots perceive now; never the simulator's truth."""
        ...

    def act(self, action: Array, ids: Ids) -> None:
        """Send actions (len(ids), 5) and let one control period pass."""
        ...


class Trigger(Protocol):
    """Notices one kind of failure from what the robots sense; see pipeline.triggers.TRIGGERS."""

    def __call__(self, senses: "Senses", /) -> NDArray[np.bool_]:
        """Which attempts have failed so, shape (n,)."""
        ...


class Recorder(Protocol):
    """Takes what happened and makes it a file that is whole or absent."""

    def close(self) -> None:
        """Finish the file; raises what the disk reported."""
        ...
