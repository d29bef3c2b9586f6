"""One trial: a policy trained with one seed and played on the scenes; only how each scene ended is kept."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.rollout import rollout
from pipeline.simulation.world import World
from pipeline.triggers import TRIGGERS, family, fired, senses_of
from schemas.recipe import HarvestConfig
from schemas.scene import SceneSpec


@dataclass(frozen=True, slots=True)
class Played:
    """How the scenes ended under one policy."""

    solved: NDArray[np.bool_]
    """Shape (scenes,)."""
    families: tuple[str, ...]
    """Failure family of each scene, '' where it was solved: the first trigger that fired, and in which subtask."""


def play(policy: Policy, scenes: Sequence[SceneSpec], config: HarvestConfig, *, threads: int = 1) -> Played:
    """Play scenes of the training-side simulation to their end, as the gate does, and name what went wrong.

    Args:
        policy: who acts.
        scenes: each with its own physics.
        config: thresholds of the triggers.
        threads: of the simulation.
    """
    world = World(compose(load_body(scenes[0].robot), scenes[0].scene), scenes,
                  from_draws([s.draws for s in scenes]), threads=threads)
    policy.reset(world.n)
    watch = _Watch(world, config)
    solved = rollout(world, policy, watch=watch.tick).success
    names = ("" if solved[i] else watch.family[i] or family("timed-out", watch.senses.phase(i))
             for i in range(world.n))
    return Played(solved, tuple(names))


class _Watch:
    """Notes the first trigger of each attempt; ends none, because whether a scene is solved is told by the truth."""

    def __init__(self, world: World, config: HarvestConfig) -> None:
        self.senses = senses_of(world.task, world.n, config)
        self.family = [""] * world.n

    def tick(self, tick: int, ids: Ids, observation: Observation, action: Array) -> NDArray[np.bool_]:
        """Take in one tick."""
        del tick, action
        self.senses.update(observation, ids)
        which = fired(self.senses, ids)
        for attempt, index in zip(map(int, ids), map(int, which), strict=True):
            if index >= 0 and not self.family[attempt]:
                self.family[attempt] = family(list(TRIGGERS)[index], self.senses.phase(attempt))
        return np.zeros(len(ids), np.bool_)
