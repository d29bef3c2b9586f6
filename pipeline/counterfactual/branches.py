"""Branches: from each moment both policies go on to the end, many times, all side by side."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.counterfactual.ending import Ending
from pipeline.counterfactual.moment import Beginning, Lab
from pipeline.counterfactual.ride import Restorable
from pipeline.counterfactual.variation import branch_seed
from pipeline.protocols import Array, Ids, Observation
from pipeline.simulation.rollout import rollout
from pipeline.triggers import Senses
from schemas.counterfactual import JudgeConfig
from schemas.recipe import HarvestConfig

PLACES = 1024
"""Branches that are played at once: enough to keep the engine busy, few enough for 0.5 GB."""


@dataclass(frozen=True, slots=True)
class Branches:
    """How both policies ended their branches of one moment; branch k of both has the same draws."""

    success: NDArray[np.bool_]
    """By the simulator's truth; champion, then candidate, shape (2, draws)."""
    why: tuple[tuple[str, ...], tuple[str, ...]]
    """Failure family of each branch, empty where it succeeded."""


def branch(moments: Sequence[Beginning], champion: Restorable, candidate: Restorable, lab: Lab, config: JudgeConfig,
           triggers: HarvestConfig) -> list[Branches]:
    """Let both policies go on from every moment until the attempt ends as attempts at work end.

    See ending.Ending. Each policy acts alone from the moment on, with the memory that it had there.

    Args:
        moments: of one task.
        champion, candidate: both forget what they knew.
        lab: where it is played.
        config: number and seed of the draws.
        triggers: thresholds that were in force at work.
    """
    each = 2 * config.draws
    size = max(1, PLACES // each)
    found: list[Branches] = []
    for k in range(0, len(moments), size):
        found += _played(moments[k:k + size], (champion, candidate), lab, config, triggers)
    return found


def _played(moments: Sequence[Beginning], policies: tuple[Restorable, Restorable], lab: Lab, config: JudgeConfig,
            triggers: HarvestConfig) -> list[Branches]:
    """One batch; places are ordered by policy, then moment, then draw."""
    n, draws = len(moments), config.draws
    half = [m for m in moments for _ in range(draws)]
    seeds = [branch_seed(m.episode.scene, m.tick, k, config.seed) for m in moments for k in range(draws)]
    scenes = [m.episode.scene.model_copy(update={"seed": seed}) for m, seed in zip(half, seeds, strict=True)]
    starts = [m.start(k % draws, seed) for k, (m, seed) in enumerate(zip(half, seeds, strict=True))] * 2
    world = lab.world(scenes * 2, [s.draws for s in starts])
    world.load(np.arange(world.n), np.stack([s.engine for s in starts]), np.stack([s.controller for s in starts]))
    pair = _Pair(policies, len(half))
    pair.restore([np.stack([m.champion for m in half]), np.stack([m.candidate for m in half])])
    ending = Ending(world, triggers)
    _remember(ending.senses, moments, np.tile(np.repeat(np.arange(n), draws), 2))
    result = rollout(world, pair, watch=ending.tick, until_success=False)
    success = result.success.reshape(2, n, draws)
    why = np.array(["" if ok else ending.why(i) for i, ok in enumerate(result.success)], object).reshape(2, n, draws)
    return [Branches(success[:, i], (tuple(why[0, i]), tuple(why[1, i]))) for i in range(n)]


class _Pair:
    """Two policies in one world: the first half of the places is the champion's, the second the candidate's."""

    def __init__(self, policies: tuple[Restorable, Restorable], half: int) -> None:
        self._policies, self._half = policies, half

    def reset(self, n: int) -> None:
        """Prepare each for half of n attempts."""
        for policy in self._policies:
            policy.reset(n // 2)

    def restore(self, rows: Sequence[Array]) -> None:
        """Put back what each remembered, one row a place."""
        self.reset(2 * self._half)
        for policy, memory in zip(self._policies, rows, strict=True):
            policy.restore(np.arange(self._half), memory)

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Each acts in its own half."""
        cut = int(np.searchsorted(ids, self._half))
        parts = ((self._policies[0], slice(None, cut), 0), (self._policies[1], slice(cut, None), self._half))
        return np.concatenate([
            policy.act(Observation(observation.state[rows], observation.environment[rows]), ids[rows] - first)
            for policy, rows, first in parts])

    def memory(self, ids: Ids) -> Array:
        """Nothing: branches are not recorded."""
        return np.zeros((len(ids), 0))


def _remember(senses: Senses, moments: Sequence[Beginning], owner: NDArray[np.intp]) -> None:
    """Let the branches sense what was recorded before their moments."""
    starts = np.array([m.tick for m in moments])
    for tick in range(int(starts.max())):
        later = [i for i, start in enumerate(starts.tolist()) if start > tick]
        row = np.zeros(len(moments), np.intp)
        row[later] = np.arange(len(later))
        ids = np.flatnonzero(starts[owner] > tick)
        traces = [moments[i].trace for i in later]
        seen = Observation(np.stack([t.state[tick] for t in traces])[row[owner[ids]]],
                           np.stack([t.environment[tick] for t in traces])[row[owner[ids]]])
        senses.update(seen, ids)
