"""What the parts of a hierarchy must be able to do: a plant senses and moves, an upper commands, a lower acts."""

from collections.abc import Mapping
from typing import Protocol

from pipeline.protocols import Array

type Memory = Mapping[str, Array]
"""All that a part must be given back to go on from a moment, bit for bit; empty for a part without memory."""


class Plant[S](Protocol):
    """n robots in one engine. S is what is sensed of them."""

    @property
    def n(self) -> int:
        """How many."""
        ...

    @property
    def clock_hz(self) -> float:
        """Steps of the engine a second [Hz]."""
        ...

    def sense(self) -> S:
        """What the parts may know of this moment."""
        ...

    def act(self, action: Array, steps: int) -> None:
        """Hold an action, shape (n, a), for some steps of the engine."""
        ...

    def save(self) -> Memory:
        """State of the robots and of what drives them."""
        ...

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        ...


class Upper[S](Protocol):
    """Says what shall be reached."""

    def command(self, sensed: S, time_s: float) -> Array:
        """Commands, shape (n, c).

        Args:
            sensed: of all robots.
            time_s: since the beginning [s].
        """
        ...

    def save(self) -> Memory:
        """What it remembers."""
        ...

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        ...


class Lower[S](Protocol):
    """Turns commands into actions."""

    def act(self, command: Array, sensed: S) -> Array:
        """Actions, shape (n, a), for commands (n, c); called once in each of its periods."""
        ...

    def save(self) -> Memory:
        """What it remembers."""
        ...

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        ...


class Forgetful:
    """A part without memory."""

    def save(self) -> Memory:
        """Nothing."""
        return {}

    def load(self, memory: Memory) -> None:
        """Nothing to go on from."""


class Zero[S](Forgetful):
    """The lower part that does nothing whatever is commanded: the control beside every result."""

    def __init__(self, action: Array) -> None:
        self._action = action
        """Shape (n, a)."""

    def act(self, command: Array, sensed: S) -> Array:
        """Always the same."""
        return self._action
