"""Planted causes: attempts that fail for a known reason, to see whether found families tell the reasons apart."""

from collections.abc import Callable, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import compose
from pipeline.simulation.physics import UNITS, from_draws
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.world import World
from pipeline.trace import Trace
from pipeline.triggers import TRIGGERS, family, fired, senses_of
from schemas.recipe import HarvestConfig
from schemas.scene import Draw, SceneSpec

type Plant = Callable[[int], SceneSpec]
"""Number of an attempt -> a start at which the cause acts."""


def _start(i: int, stratum: str, **physics: float) -> SceneSpec:
    scene = sample_scene("pick-place", "study", scene_seed("study", 71, i), stratum)
    draws = (Draw(name=name, unit=UNITS[name], value=value) for name, value in ({"noise": 0.0015} | physics).items())
    return scene.model_copy(update={"draws": tuple(draws)})


def _misseen(i: int) -> SceneSpec:
    """A camera that was pushed: the object is seen some 3 cm beside where it is."""
    towards = np.random.default_rng([73, i]).uniform(-np.pi, np.pi)
    return _start(i, "common", bias_x=float(0.032 * np.cos(towards)), bias_y=float(0.032 * np.sin(towards)))


PLANTED: MappingProxyType[str, Plant] = MappingProxyType({
    "beside": lambda i: _start(i, "beside"),
    "large": lambda i: _start(i, "large"),
    "slippery": lambda i: _start(i, "common", friction=0.04),
    "misseen": _misseen,
    "weak": lambda i: _start(i, "common", kp=0.15, frictionloss=4.0),
})
"""Cause -> its starts: two kinds of start that demonstrations lack, and three faults of robot, object and camera."""


def fail(policy: Policy, scenes: Sequence[SceneSpec], config: HarvestConfig) -> list[tuple[int, Trace, str]]:
    """Let a policy play in simulation as it would work: scenes at which a trigger fired, with trace and trigger family.

    Args:
        policy: who acts.
        scenes: each with its own physics.
        config: thresholds of the triggers.
    """
    world = World(compose(load_body(scenes[0].robot), scenes[0].scene), scenes,
                  from_draws([s.draws for s in scenes]), threads=1)
    watch = _Watch(world, config)
    policy.reset(world.n)
    rollout(world, policy, watch=watch.tick, tracer=watch.tracer, until_success=False)
    return [(i, trace, watch.family[i]) for i, trace in enumerate(watch.tracer.traces()) if watch.family[i]]


class _Watch:
    """Ends attempts as a robot at work does: where it believes in success, or a trigger fires."""

    def __init__(self, world: World, config: HarvestConfig) -> None:
        self.senses, self.tracer = senses_of(world.task, world.n, config), Tracer(world)
        self.family = [""] * world.n

    def tick(self, tick: int, ids: Ids, observation: Observation, action: Array) -> NDArray[np.bool_]:
        """Take in one tick; returns which attempts end."""
        del action
        self.senses.update(observation, ids)
        believed = self.senses.succeeded(ids)
        which = np.where(believed, -1, fired(self.senses, ids))
        for attempt, index in zip(map(int, ids), map(int, which), strict=True):
            self.tracer.phases[attempt][tick] = self.senses.phase(attempt)
            if index >= 0:
                self.family[attempt] = family(list(TRIGGERS)[index], self.senses.phase(attempt))
        return believed | (which >= 0)
