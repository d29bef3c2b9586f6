"""Augment: attempts that worked are played again under other physics and carried over to other starts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SimulationError
from pipeline.frames import Frames
from pipeline.protocols import Array
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws, randomize
from pipeline.simulation.recordings import episode_id
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.variants import Path, Playback, path_of, retarget, survival
from pipeline.simulation.world import HOME, World
from pipeline.triggers import stratum_of
from schemas.episode import Episode, Outcome, Segment
from schemas.recipe import AugmentConfig
from schemas.scene import SceneSpec
from schemas.summary import AugmentReport

HORIZON = 120
"""Longest variant [ticks]."""
NEARBY_M = 0.04
"""How far around a correction's start its variants start [m]."""
CARRIED_M = 0.08
"""Shortest way that shows how to carry [m]."""
STRETCH, TRIES = 1.6, 50
"""Largest factor between the way carried and its variant's, and how often a target is drawn to keep it."""
CELL_M = 0.02
"""Edge of the workspace cells that coverage counts [m]."""

type Parent = tuple[Episode, Frames]


@dataclass(frozen=True, slots=True)
class Augmented:
    """Variants and what became of them."""

    episodes: tuple[Episode, ...]
    """Every variant that was tried, rejected ones labelled as failures; without blob."""
    frames: dict[str, Frames]
    """Episode id -> frames, for every variant."""
    report: AugmentReport


def augment(parents: Sequence[Parent], config: AugmentConfig, *, replays: int, retargets: int, seed: int,
            generation: int, strata: Sequence[str] | None, threads: int, arm: str = "",
            progress: Callable[[int, int], None] | None = None) -> Augmented:
    """Make variants; the simulator and the success predicate judge each.

    Args:
        parents: attempts that succeeded, with their frames.
        config: width of the randomization.
        replays: variants that replay the recorded commands at the same start.
        retargets: variants carried over to another start.
        seed: decides parents, starts and draws; the same seed gives the same bits.
        generation: lap of the loop.
        strata: kinds of start that retargeting aims at; None stays near each parent's own start.
        threads: threads of the engine.
        arm: name of a study's arm: what it makes is its own, also where another arm made the same.
        progress: called as (variants done, variants in all).
    """
    parents = [p for p in parents if p[0].outcome.label == "success"]
    if not parents:
        raise SimulationError("no attempt that succeeded to make variants of", where=f"generation {generation}",
                              mend="collect more demonstrations: hardcase collect")
    episodes: list[Episode] = []
    frames: dict[str, Frames] = {}
    for transform, count in (("replay", replays), ("retarget", retargets)):
        able = [p for p in parents if transform == "replay" or grasps(p)]
        if not count or not able:
            continue
        made = _variants(able, transform, count, config, seed, generation, strata, arm)
        for episode, kept in _play(made, threads):
            episodes.append(episode)
            frames[episode.id] = kept
        if progress is not None:
            progress(len(episodes), replays + retargets)
    return Augmented(tuple(episodes), frames, _report(parents, episodes))


def remake(variant: Episode, parent: Parent, *, threads: int = 1) -> Frames:
    """Make one variant again, bit for bit, from its parent and what its record says."""
    ((_, frames),) = _play([_Variant(variant, *parent)], threads)
    return frames


@dataclass(frozen=True, slots=True)
class _Variant:
    episode: Episode
    parent: Episode
    frames: Frames


def _variants(parents: Sequence[Parent], transform: str, count: int, config: AugmentConfig, seed: int,
              generation: int, strata: Sequence[str] | None, arm: str) -> list[_Variant]:
    made: list[_Variant] = []
    for i in range(count):
        words = (seed, generation, 0 if transform == "replay" else 1, i)
        rng = np.random.default_rng([17, *words])
        parent, frames = parents[int(rng.integers(len(parents)))] if strata else parents[i % len(parents)]
        scene = _perceived(parent, frames).model_copy(update={
            "family": "augment", "seed": scene_seed("augment", *words), "draws": randomize(rng, config.widen)})
        if transform == "retarget":
            scene = _elsewhere(scene, rng, strata, _path(parent, frames).carried_m)
        origin = "replayed" if transform == "replay" else "retargeted"
        episode = Episode(
            id=episode_id(origin, scene, parent.id, transform, *([arm] if arm else [])), origin=origin, scene=scene,
            control_hz=parent.control_hz, frames=1, outcome=Outcome(label="unknown", judged_by="simulator"),
            segments=(Segment(kind="demonstration", start=0, stop=1, actor="expert"),), parent=parent.id,
            transform=transform, generation=generation)
        made.append(_Variant(episode, parent, frames))
    return made


def _perceived(parent: Episode, frames: Frames) -> SceneSpec:
    """The parent's start as its robot perceived it: the truth of a deployed attempt is not ours to know."""
    x, y, z, yaw, *target = (float(v) for v in frames.environment[0])
    return parent.scene.model_copy(update={
        "object_xy_m": (x, y), "object_yaw_rad": yaw, "target_xy_m": (target[0], target[1]), "twin": None,
        "object_half_m": load_task(parent.scene.task).nearest_half(z), "stratum": stratum_of(frames.environment[0])})


def _elsewhere(scene: SceneSpec, rng: np.random.Generator, strata: Sequence[str] | None,
               carried_m: float) -> SceneSpec:
    """Another start: of the given strata, or near this one with a way to carry that is not much longer or shorter."""
    if strata:
        fresh = sample_scene(scene.task, "augment", scene.seed, strata[int(rng.integers(len(strata)))],
                             robot=scene.robot, scene=scene.scene)
        return fresh.model_copy(update={"draws": scene.draws, "object_half_m": scene.object_half_m})
    x, y = (a + rng.uniform(-NEARBY_M, NEARBY_M) for a in scene.object_xy_m)
    task, target = load_task(scene.task), scene.target_xy_m
    for _ in range(TRIES):
        target = task.sample_target(rng, x, y)
        if 1 / STRETCH < np.hypot(target[0] - x, target[1] - y) / carried_m < STRETCH:
            break
    return scene.model_copy(update={"object_xy_m": (float(x), float(y)), "target_xy_m": target,
                                    "object_yaw_rad": float(rng.uniform(-np.pi / 4, np.pi / 4))})


def _play(variants: Sequence[_Variant], threads: int) -> list[tuple[Episode, Frames]]:
    scenes = [v.episode.scene for v in variants]
    setup = compose(load_body(scenes[0].robot), scenes[0].scene)
    world = World(setup, scenes, from_draws([s.draws for s in scenes]), threads=threads)
    seen = world.observe(np.arange(world.n)).environment
    actions = [_actions(v, seen[i]) for i, v in enumerate(variants)]
    policy = Playback([a for a, _ in actions])
    tracer = Tracer(world)
    result = rollout(world, policy, horizon=HORIZON, tracer=tracer)
    return [_finished(v.episode, trace.frames(), bool(ok), _resumes(trace.controller[:, -3], begins))
            for v, trace, ok, (_, begins) in zip(variants, tracer.traces(), result.success, actions, strict=True)]


def _begins(episode: Episode) -> int:
    """First frame that a demonstrator commanded; those before are a failing policy's."""
    return next((s.start for s in episode.segments if s.kind != "autonomous"), 0)


def _path(episode: Episode, frames: Frames) -> Path:
    return path_of(frames, f"episode {episode.id}", _begins(episode))


def grasps(parent: Parent) -> bool:
    """Whether the demonstrator's part can be carried over: it grasps, and carries far enough to show how.

    One who took over with the object in hand shows no grasp; one who only nudged it onto the mark shows a
    motion that would drag the object over the table, were it stretched to a longer way.
    """
    try:
        return _path(*parent).carried_m >= CARRIED_M
    except SimulationError:
        return False


def _actions(variant: _Variant, seen: Array) -> tuple[Array, int]:
    """What to send, and the action from which a demonstrator acts."""
    begins = _begins(variant.parent)
    if variant.episode.transform == "replay":
        return variant.frames.action.astype(np.float64), begins
    return retarget(_path(variant.parent, variant.frames), HOME, seen[[0, 1, 3]], seen[4:6]), 0


def _resumes(place: Array, begins: int) -> int:
    """First row at which the playback has reached action `begins`; a paced playback may be late."""
    return int(np.searchsorted(place, begins)) if begins else 0


def _finished(episode: Episode, frames: Frames, success: bool, begins: int) -> tuple[Episode, Frames]:
    n = len(frames)
    begins = min(begins, n - 1)
    acted = Segment(kind="intervention" if begins else "demonstration", start=begins, stop=n, actor="expert")
    before = (Segment(kind="autonomous", start=0, stop=begins, actor="policy"),) if begins else ()
    outcome = Outcome(label="success" if success else "failure", judged_by="simulator")
    return episode.model_copy(update={"frames": n, "segments": (*before, acted), "outcome": outcome}), frames


def _report(parents: Sequence[Parent], episodes: Sequence[Episode]) -> AugmentReport:
    success = np.array([e.outcome.label == "success" for e in episodes])
    origin = np.array([e.transform for e in episodes])
    tried = {str(t): int((origin == t).sum()) for t in np.unique(origin)}
    kept = {str(t): int(success[origin == t].sum()) for t in np.unique(origin)}
    before = _cells([e.scene for e, _ in parents])
    after = before | _cells([e.scene for e, ok in zip(episodes, success, strict=True) if ok])
    return AugmentReport(tried=tried, kept=kept, survival=survival([e.parent or "" for e in episodes], success),
                         coverage_before=len(before) / _workspace(), coverage_after=len(after) / _workspace())


def _cells(scenes: Sequence[SceneSpec]) -> set[tuple[int, int]]:
    return {(int(s.object_xy_m[0] // CELL_M), int(s.object_xy_m[1] // CELL_M)) for s in scenes}


def _workspace() -> float:
    """Cells of the box from which a common or rare start can be drawn: x 0 to 0.40 m, y within 0.32 m."""
    grid: NDArray[np.float64] = np.array([0.40, 0.64]) / CELL_M
    return float(grid.prod())
