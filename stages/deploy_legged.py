"""Deploy a legged robot: the released policy balances the twin, and every attempt is recorded."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.deployed import Deployed, apart
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.falls import FALL_TRIGGERS, FallSenses, fall_family, fallen
from pipeline.locomotion.robots import LeggedRobots
from pipeline.locomotion.scenes import legged_scenes, mixed_legged
from pipeline.locomotion.tracing import LeggedTracer
from pipeline.ppo.policy import check_fit
from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.shadow.ridden import Ridden
from pipeline.shadow.riders import Riders
from pipeline.simulation.recordings import episode_id, record
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import scene_seed
from pipeline.trace import Event, Trace
from pipeline.twin.legged import draw_legged_twin, twin_robots
from schemas.episode import Episode, Outcome, Segment
from schemas.recipe import Recipe
from schemas.scene import SceneSpec


def deploy_legged(policy: Policy, policy_id: str, recipe: Recipe, *, seed: int, twin: int, generation: int,
                  folder: Path, software: Mapping[str, str], riders: Riders | None = None) -> Deployed:
    """Let the policy work on the twin; an attempt ends when the robot senses that it falls, or its time is up.

    Args:
        policy: the released policy.
        policy_id: its id.
        recipe: robot, task, episodes, share of rare starts.
        seed: of the run; decides the starts.
        twin: seed of the twin.
        generation: lap of the loop.
        folder: where the MCAP files are written.
        software: strings for each file's metadata record.
        riders: candidates to ride along, made with pipeline.shadow.sizes.legged; the caller ends them.

    Raises:
        PolicyError: the policy was made for another robot or task.
    """
    scenes = deploy_legged_scenes(recipe, seed=seed, twin=twin, generation=generation)
    robots = twin_robots(draw_legged_twin(twin), scenes, threads=recipe.threads)
    check_fit(policy, recipe.robot, robots.world.width, robots.world.action_size)
    watch = _Watch(robots, threads=recipe.threads)
    driver = policy
    if riders is not None:
        joints = robots.world.action_size
        driver = Ridden(policy, riders, robots.would_send, watch.tracer, width=joints, scale=np.ones(joints))
        riders.ready()
    driver.reset(robots.n)
    result = rollout(robots, driver, watch=watch.tick, tracer=watch.tracer, until_success=False)
    traces = watch.tracer.traces()
    episodes = [_episode(scene, trace, watch, i, policy_id, generation)
                for i, (scene, trace) in enumerate(zip(scenes, traces, strict=True))]
    config = {"fallen_rad": robots.task.fallen_rad, "fallen_height": robots.task.fallen_height}
    recorded = record(folder, robots.setup, episodes, traces, config=config, software=software)
    return Deployed(tuple(recorded), result.success, float(result.ticks.sum() / robots.control_hz),
                          apart(traces), riders.states() if riders else {})


def deploy_legged_scenes(recipe: Recipe, *, seed: int, twin: int, generation: int) -> list[SceneSpec]:
    """The starts that a generation meets at work: common and rare ones in random order."""
    names = mixed_legged(recipe.task, recipe.deploy.episodes, recipe.deploy.rare_share,
                         np.random.default_rng([31, seed, generation]))
    drawn = [(scene_seed("deploy", seed, generation, i), name) for i, name in enumerate(names)]
    return legged_scenes(recipe.task, recipe.robot, "deploy", drawn, twin)


class _Watch:
    """Ends attempts by the robot's own senses."""

    def __init__(self, robots: LeggedRobots, *, threads: int) -> None:
        self.senses = FallSenses(load_legged(robots.scenes[0].robot), robots.task, robots.n, threads=threads)
        self.tracer, self.trigger = LeggedTracer(robots), np.full(robots.n, -1)

    def tick(self, tick: int, ids: Ids, observation: Observation, action: Array) -> NDArray[np.bool_]:
        """Take in one tick; returns which attempts end."""
        del action
        self.senses.update(observation, ids)
        for attempt in ids:
            self.tracer.phases[attempt][tick] = self.senses.phase(attempt)
        self.trigger[ids] = which = fallen(self.senses, ids)
        for attempt in ids[which >= 0]:
            text = f"{self.family(int(attempt))}, leaning {self.senses.lean[attempt]:.2f} rad"
            self.tracer.events[int(attempt)].append(Event(tick, 30, "trigger", text))
        return which >= 0

    def family(self, attempt: int) -> str:
        """Failure family of an attempt that fell."""
        return fall_family([*FALL_TRIGGERS][int(self.trigger[attempt])], self.senses, attempt)


def _episode(scene: SceneSpec, trace: Trace, watch: _Watch, attempt: int, policy: str, generation: int) -> Episode:
    n, index = len(trace), int(watch.trigger[attempt])
    outcome = Outcome(label="success", judged_by="sensors")
    if index >= 0:
        outcome = Outcome(label="failure", judged_by="sensors", trigger=[*FALL_TRIGGERS][index], tick=n - 1,
                          family=watch.family(attempt))
    return Episode(id=episode_id("deployed", scene, policy), origin="deployed", scene=scene,
                   control_hz=trace.hz, frames=n, outcome=outcome, policy=policy, generation=generation,
                   segments=(Segment(kind="autonomous", start=0, stop=n, actor=policy),))
