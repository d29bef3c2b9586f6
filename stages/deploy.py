"""Deploy: the released policy drives the twin, and every attempt is recorded."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.disagreement import disagreement
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.simulation.recordings import Recorded, episode_id, record
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


@dataclass(frozen=True, slots=True)
class Rider:
    """A policy in the champion's shadow: it sees what the champion sees and never acts."""

    id: str
    policy: OnnxPolicy


@dataclass(frozen=True, slots=True)
class Deployed:
    """Recorded attempts; the truth is for the report alone."""

    recorded: tuple[Recorded, ...]
    truth: NDArray[np.bool_]
    """Whether each attempt really succeeded, shape (n,)."""
    robot_s: float
    """Robot time spent [s]."""
    disagreement: Array
    """Mean disagreement of the rider with the champion in each attempt, NaN without one, shape (n,)."""


def deploy(policy: Policy, policy_id: str, recipe: Recipe, *, seed: int, twin: int, generation: int, folder: Path,
           software: Mapping[str, str], rider: Rider | None = None) -> Deployed:
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
        rider: another policy to ride along.
    """
    scenes = deploy_scenes(recipe, seed=seed, twin=twin, generation=generation)
    world = twin_world(draw_twin(twin), scenes, threads=recipe.threads)
    watch = _Watch(world, recipe.harvest)
    driver = policy if rider is None else _Ridden(policy, rider, world, watch.tracer)
    driver.reset(world.n)
    result = rollout(world, driver, watch=watch.tick, tracer=watch.tracer, until_success=False)
    traces = watch.tracer.traces()
    episodes = [_episode(scene, trace, watch, i, policy_id, generation)
                for i, (scene, trace) in enumerate(zip(scenes, traces, strict=True))]
    recorded = record(folder, world.setup, episodes, traces, config=recipe.harvest.model_dump(), software=software)
    nothing = np.full(world.n, np.nan)
    mean = np.array([t.shadows[rider.id].disagreement.mean() for t in traces]) if rider else nothing
    return Deployed(tuple(recorded), result.success, float(result.ticks.sum() / world.control_hz), mean)


def deploy_scenes(recipe: Recipe, *, seed: int, twin: int, generation: int) -> list[SceneSpec]:
    """The starts that a generation meets at work: common and rare ones in random order."""
    names = mixed_strata(recipe.task, recipe.deploy.episodes, recipe.deploy.rare_share,
                         np.random.default_rng([31, seed, generation]))
    return [sample_scene(recipe.task, "deploy", scene_seed("deploy", seed, generation, i), name, robot=recipe.robot,
                         scene=recipe.scene, twin=twin) for i, name in enumerate(names)]


class _Ridden:
    """The champion with a rider in its shadow: same observations, and the rider's actions go to the record alone."""

    def __init__(self, champion: Policy, rider: Rider, world: World, tracer: Tracer) -> None:
        self._champion, self._rider, self._world, self._tracer = champion, rider, world, tracer

    def reset(self, n: int) -> None:
        """Prepare both for n attempts."""
        self._champion.reset(n)
        self._rider.policy.reset(n)

    def act(self, observation: Observation, ids: Ids) -> Array:
        """The champion's actions, untouched."""
        action = self._champion.act(observation, ids)
        other = self._rider.policy.act(observation, ids)
        self._tracer.pend(f"shadow/{self._rider.id}/joint", self._world.would_send(other, ids))
        self._tracer.pend(f"shadow/{self._rider.id}/disagreement", disagreement(other, action))
        return action

    def memory(self, ids: Ids) -> Array:
        """The champion's memory."""
        return self._champion.memory(ids)


class _Watch:
    """Ends attempts by the robot's own senses."""

    def __init__(self, world: World, config: HarvestConfig) -> None:
        self.senses, self.tracer = senses_of(world.task, world.n, config), Tracer(world)
        self.trigger = np.full(world.n, -1)

    def tick(self, tick: int, ids: Ids, observation: Observation, action: Array) -> NDArray[np.bool_]:
        """Take in one tick; returns which attempts end."""
        del action
        self.senses.update(observation, ids)
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

