"""Deploy: the released policy drives the twin, and every attempt is recorded."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import override

import numpy as np
from numpy.typing import NDArray

from pipeline.deployed import Deployed, apart
from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.shadow.ridden import Ridden
from pipeline.shadow.riders import Riders
from pipeline.signals.curves import curves
from pipeline.signals.neighbours import Neighbours
from pipeline.signals.tick import Signals, plan_of
from pipeline.simulation.recordings import episode_id, record
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import mixed_strata, sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.world import World
from pipeline.trace import Event, Trace
from pipeline.triggers import TRIGGERS, family, fired, senses_of
from pipeline.twin.twin import draw_twin, twin_world
from schemas.episode import Episode, Outcome, Segment
from schemas.recipe import HarvestConfig, Recipe
from schemas.scene import SceneSpec

type Sight = Callable[[Policy, World], AbstractContextManager[Policy]]
"""Hands the pictures of this robot's cameras to a driver, see pipeline.simulation.eyes.with_eyes."""


def deploy(policy: Policy, policy_id: str, recipe: Recipe, *, seed: int, twin: int, generation: int, folder: Path,
           software: Mapping[str, str], riders: Riders | None = None,
           neighbours: Neighbours | None = None,
           sight: Sight | None = None) -> Deployed:
    """Let the policy work on the twin; an attempt ends when the robot believes in success or a trigger fires.

    Args:
        policy: the released policy.
        policy_id: its id.
        recipe: episodes, share of rare starts, triggers.
        seed: of the run; decides the starts.
        twin: seed of the twin.
        generation: lap of the loop.
        folder: where the MCAP files are written.
        software: strings for each file's metadata record.
        riders: candidates to ride along; the caller ends them.
        neighbours: what the champion learnt from; with these or with candidates, signals of risk are recorded.
        sight: for a policy that sees; None for one that does not.
    """
    scenes = deploy_scenes(recipe, seed=seed, twin=twin, generation=generation)
    world = twin_world(draw_twin(twin), scenes, threads=recipe.threads)
    watch = _Watch(world, recipe.harvest)
    driver = policy if riders is None else _Ridden(policy, riders, world, watch.tracer, neighbours)
    if riders is not None:
        riders.ready()
    driver.reset(world.n)
    with sight(driver, world) if sight else nullcontext(driver) as seeing:
        result = rollout(world, seeing, watch=watch.tick, tracer=watch.tracer, until_success=False)
    traces = watch.tracer.traces()
    episodes = [_episode(scene, trace, watch, i, policy_id, generation)
                for i, (scene, trace) in enumerate(zip(scenes, traces, strict=True))]
    recorded = record(folder, world.setup, episodes, traces, config=recipe.harvest.model_dump(), software=software)
    return Deployed(tuple(recorded), result.success, float(result.ticks.sum() / world.control_hz),
                    apart(traces), riders.states() if riders else {},
                    curves([t.signals for t in traces], ~result.success))


def deploy_scenes(recipe: Recipe, *, seed: int, twin: int, generation: int) -> list[SceneSpec]:
    """The starts that a generation meets at work: common and rare ones in random order."""
    names = mixed_strata(recipe.task, recipe.deploy.episodes, recipe.deploy.rare_share,
                         np.random.default_rng([31, seed, generation]))
    return [sample_scene(recipe.task, "deploy", scene_seed("deploy", seed, generation, i), name, robot=recipe.robot,
                         scene=recipe.scene, twin=twin) for i, name in enumerate(names)]


class _Ridden(Ridden):
    """The champion with riders in its shadow, and what is computed of the risk from all of them."""

    def __init__(self, champion: Policy, riders: Riders, world: World, tracer: Tracer,
                 neighbours: Neighbours | None) -> None:
        super().__init__(champion, riders, world.would_send, tracer)
        self._neighbours, self._watched = neighbours, bool(neighbours or riders.ids)
        self._signals = Signals(world.n, neighbours)

    @override
    def reset(self, n: int) -> None:
        """Prepare all for n attempts."""
        super().reset(n)
        self._signals = Signals(n, self._neighbours)

    @override
    def planned(self, ids: Ids) -> Array | None:
        """The champion's plan, where anybody watches."""
        return plan_of(self.champion, ids) if self._watched else None

    @override
    def signals(self, observation: Observation, action: Array, answers: Mapping[str, Array], ids: Ids,
                plan: Array | None) -> Mapping[str, Array]:
        """See pipeline.signals.tick, where anybody watches."""
        return self._signals.tick(observation, action, answers, ids, plan) if self._watched else {}


class _Watch:
    """Ends attempts by the robot's own senses."""

    def __init__(self, world: World, config: HarvestConfig) -> None:
        self.senses, self.tracer = senses_of(world.task, world.n, config), Tracer(world)
        self.trigger = np.full(world.n, -1)

    def tick(self, tick: int, ids: Ids, observation: Observation, action: Array) -> NDArray[np.bool_]:
        """Take in one tick; returns which attempts end."""
        del action
        self.senses.update(observation, ids)
        if (apart := self.tracer.newest().get("signal/apart")) is not None:
            self.senses.differ(apart, ids)
        for attempt in ids:
            self.tracer.phases[attempt][tick] = self.senses.phase(attempt)
        believed = self.senses.succeeded(ids)
        which = np.where(believed, -1, fired(self.senses, ids))
        self.trigger[ids] = which
        for attempt, index in zip(ids[which >= 0], which[which >= 0], strict=True):
            text = f"{list(TRIGGERS)[index]} in phase {self.senses.phase(attempt)}"
            self.tracer.events[int(attempt)].append(Event(tick, 30, "trigger", text))
        return believed | (which >= 0)


def _episode(scene: SceneSpec, trace: Trace, watch: _Watch, attempt: int, policy: str, generation: int) -> Episode:
    n, index = len(trace), int(watch.trigger[attempt])
    if index >= 0:
        trigger = list(TRIGGERS)[index]
        outcome = Outcome(label="failure", judged_by="sensors", trigger=trigger, tick=n - 1,
                          family=family(trigger, watch.senses.phase(attempt)))
    else:
        outcome = Outcome(label="success", judged_by="sensors")
    return Episode(id=episode_id("deployed", scene, policy), origin="deployed", scene=scene,
                   control_hz=trace.hz, frames=n, outcome=outcome, policy=policy, generation=generation,
                   segments=(Segment(kind="autonomous", start=0, stop=n, actor=policy),))

