"""Augment: attempts that worked are played again under other physics and carried over to other starts."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SimulationError
from pipeline.frames import Frames
from pipeline.protocols import Array
from pipeline.simulation.appearance import randomize_look
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import compose
from pipeline.simulation.perceived import as_perceived
from pipeline.simulation.physics import from_draws, randomize
from pipeline.simulation.recordings import episode_id
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.variants import Path, Playback, path_of, retarget, survival
from pipeline.simulation.world import HOME, World
from pipeline.trace import Trace
from schemas.episode import Episode, Outcome, Segment
from schemas.recipe import AugmentConfig
from schemas.scene import SceneSpec
from schemas.summary import AugmentReport

HORIZON = 120
"""Longest variant [ticks]."""
NEARBY_M = 0.04
"""How far around a given start variants start [m]."""
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
            generation: int, threads: int, strata: Sequence[str] = (), near: Sequence[Parent] = (),
            same_mark: Collection[str] = (), arm: str = "",
            progress: Callable[[int, int], None] | None = None) -> Augmented:
    """Make variants; the simulator and the success predicate judge each.

    Args:
        parents: attempts that succeeded, with their frames; whole demonstrations among them are carried over.
        config: width of the randomization.
        replays: variants that replay the recorded commands at the same start.
        retargets: variants carried over to another start.
        seed: decides parents, starts and draws; the same seed gives the same bits.
        generation: lap of the loop.
        threads: threads of the engine.
        strata: kinds of start that demonstrations are carried over to, with the object that they held.
        near: attempts in whose neighbourhood they are carried over instead: each in turn, start and size of the
            object as its robot perceived them.
        same_mark: ids of those among them whose mark, too, is kept near: they went wrong on the way to it.
        arm: name of a study's arm: what it makes is its own, also where another arm made the same.
        progress: called as (variants done, variants in all).
    """
    parents = [p for p in parents if p[0].outcome.label == "success"]
    if not parents:
        raise SimulationError("no attempt that succeeded to make variants of", where=f"generation {generation}",
                              mend="collect more demonstrations: hardcase collect")
    plan = _Plan(config, seed, generation, tuple(strata), tuple(near), frozenset(same_mark), arm)
    episodes: list[Episode] = []
    frames: dict[str, Frames] = {}
    for transform, count in (("replay", replays), ("retarget", retargets)):
        able = [p for p in parents if transform == "replay" or grasps(p)]
        if not count or not able:
            continue
        for episode, kept in _play([plan.variant(able, transform, i) for i in range(count)], threads):
            episodes.append(episode)
            frames[episode.id] = kept
        if progress is not None:
            progress(len(episodes), replays + retargets)
    return Augmented(tuple(episodes), frames, _report([*parents, *near], episodes))


def remake(variant: Episode, parent: Parent, *, threads: int = 1) -> Frames:
    """Make one variant again, bit for bit, from its parent and what its record says."""
    ((_, frames),) = _play([_Variant(variant, *parent)], threads)
    return frames


def replayed(variants: Sequence[tuple[Episode, Parent]], *, threads: int = 1) -> dict[str, Array]:
    """Play variants again for what no shard holds: id -> mjSTATE_INTEGRATION rows, one a frame."""
    again = [_Variant(variant, *parent) for variant, parent in variants]
    return {v.episode.id: trace.sim_state for v, (trace, *_) in zip(again, _traced(again, threads), strict=True)}


@dataclass(frozen=True, slots=True)
class _Variant:
    episode: Episode
    parent: Episode
    frames: Frames


@dataclass(frozen=True, slots=True)
class _Plan:
    """Which variant is made of what; see the arguments of `augment`."""

    config: AugmentConfig
    seed: int
    generation: int
    strata: tuple[str, ...]
    near: tuple[Parent, ...]
    same_mark: frozenset[str]
    arm: str

    def variant(self, parents: Sequence[Parent], transform: str, i: int) -> _Variant:
        """The i-th variant of a transform, still to be played."""
        words = (self.seed, self.generation, 0 if transform == "replay" else 1, i)
        rng = np.random.default_rng([17, *words])
        parent, frames = parents[int(rng.integers(len(parents)))] if self._elsewhere else parents[i % len(parents)]
        scene = as_perceived(parent.scene, frames.environment[0]).model_copy(update={
            "family": "augment", "seed": scene_seed("augment", *words), "draws": randomize(rng, self.config.widen)})
        if self.config.appearance:  # from a generator of its own: physics and start are those of a run without looks
            look = randomize_look(np.random.default_rng([19, *words]), self.config.widen)
            scene = scene.model_copy(update={"draws": (*scene.draws, *look)})
        made_by = transform
        if transform == "retarget" and self.near:
            place = self.near[i % len(self.near)]
            scene = _close_to(place, scene, rng, same_mark=place[0].id in self.same_mark)
            made_by = f"retarget near {place[0].id}"
        elif transform == "retarget" and self.strata:
            scene = _within(self.strata, scene, rng)
        origin = "replayed" if transform == "replay" else "retargeted"
        episode = Episode(
            id=episode_id(origin, scene, parent.id, made_by, *([self.arm] if self.arm else [])), origin=origin,
            scene=scene, control_hz=parent.control_hz, frames=1,
            outcome=Outcome(label="unknown", judged_by="simulator"),
            segments=(Segment(kind="demonstration", start=0, stop=1, actor="expert"),), parent=parent.id,
            transform=made_by, generation=self.generation)
        return _Variant(episode, parent, frames)

    @property
    def _elsewhere(self) -> bool:
        return bool(self.strata or self.near)


def _within(strata: Sequence[str], scene: SceneSpec, rng: np.random.Generator) -> SceneSpec:
    """A start of one of the strata, with the object of `scene`."""
    fresh = sample_scene(scene.task, "augment", scene.seed, strata[int(rng.integers(len(strata)))],
                         robot=scene.robot, scene=scene.scene)
    return fresh.model_copy(update={"draws": scene.draws, "object_half_m": scene.object_half_m})


def _close_to(place: Parent, scene: SceneSpec, rng: np.random.Generator, *, same_mark: bool) -> SceneSpec:
    """A start in the neighbourhood of another attempt's, with an object of the size perceived there.

    To any mark; or to one in the neighbourhood of the mark there, as far as a task allows it.
    """
    there = as_perceived(place[0].scene, place[1].environment[0])
    x, y = (a + rng.uniform(-NEARBY_M, NEARBY_M) for a in there.object_xy_m)
    task, yaw = load_task(scene.task), float(rng.uniform(-np.pi / 4, np.pi / 4))
    mark = task.sample_target(rng, x, y)
    if same_mark:
        close = there.target_xy_m[0] + rng.uniform(-NEARBY_M, NEARBY_M), there.target_xy_m[1] + rng.uniform(
            -NEARBY_M, NEARBY_M)
        mark = close if np.hypot(close[0] - x, close[1] - y) >= task.target_away_m else mark
    return scene.model_copy(update={
        "object_xy_m": (float(x), float(y)), "object_yaw_rad": yaw, "target_xy_m": (float(mark[0]), float(mark[1])),
        "object_half_m": there.object_half_m, "stratum": there.stratum})


def _play(variants: Sequence[_Variant], threads: int) -> list[tuple[Episode, Frames]]:
    return [_finished(v.episode, trace.frames(), ok, _resumes(trace.controller[:, -3], begins))
            for v, (trace, ok, begins) in zip(variants, _traced(variants, threads), strict=True)]


def _traced(variants: Sequence[_Variant], threads: int) -> list[tuple[Trace, bool, int]]:
    """What each variant left behind, whether it succeeded, and the action from which a demonstrator acts."""
    scenes = [v.episode.scene for v in variants]
    setup = compose(load_body(scenes[0].robot), scenes[0].scene)
    world = World(setup, scenes, from_draws([s.draws for s in scenes]), threads=threads)
    seen = world.observe(np.arange(world.n)).environment
    actions = [_actions(v, seen[i]) for i, v in enumerate(variants)]
    policy = Playback([a for a, _ in actions])
    tracer = Tracer(world)
    result = rollout(world, policy, horizon=HORIZON, tracer=tracer)
    return [(trace, bool(ok), begins)
            for trace, ok, (_, begins) in zip(tracer.traces(), result.success, actions, strict=True)]


def _begins(episode: Episode) -> int:
    """First frame that a demonstrator commanded; those before are a failing policy's."""
    return next((s.start for s in episode.segments if s.kind != "autonomous"), 0)


def _path(episode: Episode, frames: Frames) -> Path:
    return path_of(frames, f"episode {episode.id}")


def grasps(parent: Parent) -> bool:
    """Whether an attempt can be carried over: a whole demonstration that grasps and lifts.

    A correction cannot: it begins where a policy failed, and its commands answer what they found there.
    """
    try:
        return _begins(parent[0]) == 0 and len(_path(*parent).pose) > 0
    except SimulationError:
        return False


def _actions(variant: _Variant, seen: Array) -> tuple[Array, int]:
    """What to send, and the action from which a demonstrator acts."""
    if variant.episode.transform == "replay":
        return variant.frames.action.astype(np.float64), _begins(variant.parent)
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
    origin = np.array([str(e.transform).split()[0] for e in episodes])
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
