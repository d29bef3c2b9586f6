"""A twin: one robot with hidden physics, drawn by seed, on which policies are deployed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.errors import ConfigError
from pipeline.simulation.bodies import ROBOTS, Flex, arm
from pipeline.simulation.model import Setup, compose
from pipeline.simulation.physics import NOMINAL, UNITS, from_draws
from pipeline.simulation.scenes import Contact
from pipeline.simulation.world import World
from pipeline.twin import law
from schemas.scene import Draw, SceneSpec


@dataclass(frozen=True, slots=True)
class Twin:
    """The hidden physics of one robot; the same in every attempt."""

    seed: int
    draws: tuple[Draw, ...]
    flex: Flex | None

    def outside(self, ranges: dict[str, tuple[float, float]]) -> tuple[str, ...]:
        """Parameters beyond the given training ranges, and structure that training lacks."""
        drawn = {d.name: d.value for d in self.draws}
        names = [n for n, (low, high) in ranges.items() if not low <= drawn.get(n, NOMINAL[n]) <= high]
        structure = [n for n in ("stiction", "jitter") if drawn.get(n, 0.0) > 0]
        return (*names, *structure, *(("flex",) if self.flex else ()))


def draw_twin(seed: int) -> Twin:
    """The twin of that seed, always the same."""
    rng = np.random.default_rng([0x7717, seed])
    draws = [Draw(name=n, unit=UNITS[n], value=float(draw(rng))) for n, draw in law.CONTINUOUS.items()]
    stiction, has_stiction = rng.uniform(*law.STICTION), rng.random() < law.STICTION_SHARE
    stiffness, has_flex = rng.uniform(*law.FLEX_N_M_RAD), rng.random() < law.FLEX_SHARE
    if has_stiction:
        draws.append(Draw(name="stiction", unit=UNITS["stiction"], value=float(stiction)))
    flex = Flex(stiffness=float(stiffness), damping=law.FLEX_DAMPING) if has_flex else None
    return Twin(seed, tuple(draws), flex)


def twin_setup(twin: Twin, robot: str, scene: str) -> Setup:
    """The twin's own compiled model; its controller knows only the nominal kinematics."""
    if robot not in ROBOTS or robot != "arm":
        raise ConfigError(f"no twin of robot {robot!r}", where="recipe robot", mend="use robot: arm")
    return compose(arm(flex=twin.flex), scene, Contact.model_validate(dict(law.CONTACT)), nominal=arm())


def twin_world(twin: Twin, scenes: Sequence[SceneSpec], *, threads: int) -> World:
    """Attempts on the twin, side by side."""
    setup = twin_setup(twin, scenes[0].robot, scenes[0].scene)
    return World(setup, scenes, from_draws([twin.draws] * len(scenes)), threads=threads)
