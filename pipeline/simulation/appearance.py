"""What a scene looks like: light, colours, texture of the table and pose of the camera, and how training draws them.

Nothing here touches physics: a look is applied to a model that only renders.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from schemas.scene import Draw

type Look = Mapping[str, float]
"""Every name of LOOKS -> its value."""


@dataclass(frozen=True, slots=True)
class Trait:
    """One thing about a look: its unit, what it is without randomization, and how training draws it."""

    unit: str
    nominal: float
    draw: Callable[[np.random.Generator, float], float]
    """(generator, factor on the range's width) -> value."""


def _uniform(unit: str, nominal: float, low: float, high: float, floor: float = -np.inf) -> Trait:
    middle, half = (low + high) / 2, (high - low) / 2
    return Trait(unit, nominal, lambda rng, widen: max(floor, float(middle + half * widen * rng.uniform(-1, 1))))


def _around(unit: str, sd: float) -> Trait:
    return Trait(unit, 0.0, lambda rng, widen: float(np.clip(rng.normal(0, sd), -2 * sd, 2 * sd)) * widen)


LOOKS: Mapping[str, Trait] = MappingProxyType({
    "look_light": _uniform("1", 1.0, 0.7, 1.25, 0.1),
    "look_warmth": _uniform("1", 0.0, -0.15, 0.15),
    "look_lamp_x": _uniform("m", 0.2, -0.6, 1.0),
    "look_lamp_y": _uniform("m", -0.6, -1.0, 1.0),
    "look_table": _uniform("1", 1.0, 0.6, 1.2, 0.1),
    "look_table_red": _uniform("1", 0.0, -0.12, 0.12),
    "look_table_blue": _uniform("1", 0.0, -0.12, 0.12),
    "look_texture": _uniform("1", 0.0, 0.0, 0.4, 0.0),
    "look_grain": _uniform("1", 0.5, 0.0, 1.0, 0.0),
    "look_pattern": Trait("1", 0.0, lambda rng, widen: float(rng.integers(1, 1 << 16))),
    "look_object": _uniform("1", 0.0, -0.1, 0.1),
    "look_camera_x": _around("m", 0.008),
    "look_camera_y": _around("m", 0.008),
    "look_camera_z": _around("m", 0.008),
    "look_camera_pan": _around("rad", 0.012),
    "look_camera_tilt": _around("rad", 0.012),
    "look_camera_roll": _around("rad", 0.012),
})
"""Name of a draw -> how it is drawn.

Light: factor on all lamps, warmth (red up and blue down by this share), place of the lamp. Table: factor on its colour,
shifts of red and blue, contrast of a texture, its grain from coarse to fine, and the number of its pattern. Shift of
the colours of cube and mark. Camera: how far it is moved right, up and back, and turned left, up and about its line of
sight.

Add one: an entry here, and what it does in pipeline/simulation/eyes.py."""

NOMINAL: Look = MappingProxyType({name: trait.nominal for name, trait in LOOKS.items()})
"""The look of every scene that nothing was drawn for."""


def randomize_look(rng: np.random.Generator, widen: float = 1.0) -> tuple[Draw, ...]:
    """Draw every trait once, in the table's order."""
    return tuple(Draw(name=name, unit=t.unit, value=t.draw(rng, widen)) for name, t in LOOKS.items())


def look_from(draws: Iterable[Draw]) -> Look:
    """The look that draws describe; what is not drawn stays nominal, draws of physics say nothing about it."""
    return MappingProxyType({**NOMINAL, **{d.name: d.value for d in draws if d.name in LOOKS}})


def look_draws(draws: Iterable[Draw]) -> tuple[Draw, ...]:
    """Those draws that are about the look."""
    return tuple(d for d in draws if d.name in LOOKS)
