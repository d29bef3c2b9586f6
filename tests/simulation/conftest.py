"""Starts and worlds of the reference arm at the table."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from pipeline.simulation.bodies import arm
from pipeline.simulation.expert import Expert
from pipeline.simulation.model import Setup, compose
from pipeline.simulation.physics import UNITS, from_draws
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.world import World
from pipeline.trace import Trace
from schemas.scene import Draw, SceneSpec

NOTHING = np.array([0, 0, 0, 0, 0.08])


@pytest.fixture(scope="session")
def setup() -> Setup:
    return compose(arm(), "table")


@pytest.fixture(scope="session")
def starts() -> Callable[..., list[SceneSpec]]:
    def make(n: int, stratum: str = "common", first: int = 0) -> list[SceneSpec]:
        return [sample_scene("pick-place", "study", scene_seed("study", first + i), stratum) for i in range(n)]

    return make


@pytest.fixture(scope="session")
def draws() -> Callable[..., list[tuple[Draw, ...]]]:
    def make(n: int, **values: float) -> list[tuple[Draw, ...]]:
        return [tuple(Draw(name=k, unit=UNITS[k], value=v) for k, v in values.items())] * n

    return make


@pytest.fixture(scope="session")
def make_world(setup, draws) -> Callable[..., World]:
    """The same physics for every attempt, by name."""
    def make(scenes: Sequence[SceneSpec], *, threads: int = 2, **values: float) -> World:
        return World(setup, scenes, from_draws(draws(len(scenes), **values)), threads=threads)

    return make


@pytest.fixture(scope="session")
def idle() -> Callable[[World, int], None]:
    """Let ticks pass in which the arm holds still."""
    def wait(world: World, ticks: int) -> None:
        for _ in range(ticks):
            world.act(np.tile(NOTHING, (world.n, 1)), np.arange(world.n))

    return wait


@pytest.fixture(scope="session")
def demonstrations(make_world, starts) -> tuple[list[SceneSpec], list[Trace]]:
    """Twelve nominal attempts by the expert, all successes."""
    scenes = starts(12)
    world, expert = make_world(scenes), Expert()
    expert.reset(world.n)
    tracer = Tracer(world)
    assert rollout(world, expert, tracer=tracer).success.all()
    return scenes, tracer.traces()
