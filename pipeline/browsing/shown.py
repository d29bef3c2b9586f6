"""Shown: one attempt as it is drawn, on a time line that begins at 0; arrays only, no viewer."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.trace import Event, Rows

type Colour = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Shape:
    """A box, cylinder or sphere, fixed to a body."""

    kind: str
    size: tuple[float, float, float]
    """Half edges of a box; radius, 0 and half length of a cylinder; radius of a sphere and two zeros [m]."""
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Its middle in the body's frame [m]."""
    turn: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Quaternion w, x, y, z in the body's frame."""
    colour: Colour = (200, 200, 205, 255)
    solid: bool = True
    """Drawn as edges where False."""


@dataclass(frozen=True, slots=True)
class Body:
    """Something that moves, or stands, in the 3D view."""

    name: str
    shapes: tuple[Shape, ...]
    poses: Rows
    """x, y, z [m], qw, qx, qy, qz in the world, shape (m, 7); (1, 7) for what never moves."""


@dataclass(frozen=True, slots=True)
class Pictures:
    """What one camera saw, as it was recorded."""

    seconds: Rows
    """From the start of the attempt, shape (k,) [s]."""
    blobs: tuple[bytes, ...]
    """JPEG or PNG."""


@dataclass(frozen=True, slots=True)
class Shown:
    """One attempt of m moments."""

    title: str
    seconds: Rows
    """From the start, shape (m,) [s]."""
    lines: Mapping[str, Rows]
    """Path of a curve, as 'joints/joint1/state' -> values, shape (m,); curves of one folder share a plot."""
    bodies: tuple[Body, ...] = ()
    path: Rows = field(default_factory=lambda: np.zeros((0, 3)))
    """Where the end effector was, shape (m, 3) [m]; (0, 3) where that is not known."""
    states: Mapping[str, Mapping[int, str]] = field(default_factory=dict[str, Mapping[int, str]])
    """Lane, as 'phase' -> moment from which on -> what it was."""
    events: tuple[Event, ...] = ()
    pictures: Mapping[str, Pictures] = field(default_factory=dict[str, Pictures])
    """Camera -> its pictures."""
    facts: str = ""
    """What is known of the attempt, as Markdown."""

    def __len__(self) -> int:
        return len(self.seconds)


def changes(names: tuple[str, ...]) -> dict[int, str]:
    """Moment -> name, where a name differs from the one before."""
    return {k: name for k, name in enumerate(names) if k == 0 or name != names[k - 1]}


def even(count: int, hz: float) -> NDArray[np.float64]:
    """Seconds of moments 0, 1, 2, ... at a rate."""
    return np.arange(count) / hz
