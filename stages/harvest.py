"""Harvest: failures become hard cases, and a stand-in for a person corrects some of them on the robot."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.errors import ConfigError
from pipeline.files import short_id
from pipeline.simulation.recordings import Recorded, episode_id, record
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import load_task
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.world import CONTROLLER_WIDTH, World
from pipeline.trace import Event, Trace
from pipeline.triggers import stratum_of
from pipeline.twin.operator import Operator
from pipeline.twin.twin import draw_twin, twin_world
from schemas.episode import Episode, Origin, Outcome, Segment
from schemas.hardcase import HardCase
from schemas.recipe import HarvestConfig, Recipe
from schemas.scene import SceneSpec

type Attempt = tuple[Episode, Trace]

OPERATOR = "stand-in"
"""Pseudonym of the simulated operator."""


@dataclass(frozen=True, slots=True)
class Harvested:
    """Hard cases and what was recorded of their corrections."""

    cases: tuple[HardCase, ...]
    chosen: tuple[HardCase, ...]
    """Those that were picked for correction, in that order."""
    recorded: tuple[Recorded, ...]
    robot_s: float
    """Robot time that the corrections took [s]."""


def hard_cases(attempts: Sequence[Attempt], generation: int, arm: str = "") -> list[HardCase]:
    """A hard case for every deployed attempt that a trigger stopped; each arm of a study has its own."""
    return [
        HardCase(id=short_id("hard case", episode.id, arm), episode=episode.id, trigger=episode.outcome.trigger or "",
                 tick=episode.outcome.tick or 0, family=episode.outcome.family or "",
                 stratum=stratum_of(trace.environment[0]), generation=generation)
        for episode, trace in attempts if episode.outcome.label == "failure"
    ]


def choose(cases: Sequence[HardCase], config: HarvestConfig, ranked: Sequence[str] = ()) -> list[HardCase]:
    """Cases to correct, as many as the recipe allows, by its named rule; in turn from every kind of start where it
    names none, so that no frequent kind crowds out a rare one.

    Args:
        cases: of one lap.
        config: `corrections` and `order`.
        ranked: ids of all cases, the one that is worth most first: what the order 'value' goes by.

    Raises:
        ConfigError: the order is 'value' and a case has no place in the queue.
    """
    if config.order == "value":
        place = {id: k for k, id in enumerate(ranked)}
        if missing := [c.id for c in cases if c.id not in place]:
            raise ConfigError(f"hard case {missing[0]} has no place in the queue", where="harvest.order: value",
                              mend="hand in the queue of stages.mine.mine, made of the same cases")
        return sorted(cases, key=lambda c: place[c.id])[:config.corrections]
    if config.order == "random":
        return sorted(cases, key=lambda c: short_id("any", c.id))[:config.corrections]
    queues = [[c for c in cases if c.stratum == name] for name in dict.fromkeys(c.stratum for c in cases)]
    turns = (queue[k] for k in range(max(map(len, queues), default=0)) for queue in queues if k < len(queue))
    return list(turns)[:config.corrections]


def harvest(attempts: Sequence[Attempt], recipe: Recipe, *, twin: int, generation: int, folder: Path,
            software: Mapping[str, str], arm: str = "", record_corrections: bool = True,
            judged: Sequence[HardCase] | None = None, ranked: Sequence[str] = (),
            progress: Callable[[int, int], None] | None = None) -> Harvested:
    """Correct hard cases on the robot as it stands; attempt and correction form one episode.

    Args:
        attempts: deployed attempts with their recordings, restorable.
        recipe: how many corrections, the operator's habits, and whether this is the oracle arm.
        twin: seed of the twin.
        generation: lap of the loop.
        folder: where the MCAP files are written.
        software: strings for each file's metadata record.
        arm: name of the arm of a study; its hard cases are its own.
        record_corrections: False only chooses the cases.
        judged: cases that were made already, in their order: moments at which a policy was judged wrong, or cases that
            were told apart; they take the place of the attempts that a trigger stopped.
        ranked: ids of the cases by what their correction is worth, for the order 'value'.
        progress: called as (corrections done, corrections in all).
    """
    cases, config = hard_cases(attempts, generation, arm) if judged is None else list(judged), recipe.harvest
    chosen = choose(cases, config, ranked)
    if not chosen or not record_corrections:
        return Harvested(tuple(cases), tuple(chosen), (), 0.0)
    by_id = {e.id: (e, t) for e, t in attempts}
    taken = [_taken(*by_id[c.episode], c, config) for c in chosen]
    world = _restored(taken, recipe, twin)
    operator = Operator(world, config, [e.scene.seed for e, _ in taken], perfect=config.oracle)
    operator.reset(world.n)
    tracer = Tracer(world)
    rollout(world, operator, tracer=tracer)
    origin: Origin = "oracle" if config.oracle else "corrected"
    made = [_joined(*attempt, trace, operator.delay, origin, generation, load_task(recipe.task).within_m)
            for attempt, trace in zip(taken, tracer.traces(), strict=True)]
    recorded = record(folder, world.setup, [e for e, _ in made], [t for _, t in made], config=config.model_dump(),
                      software=software)
    if progress is not None:
        progress(len(chosen), len(chosen))
    corrections = {c.id: r.episode for c, r in zip(chosen, recorded, strict=True)}
    cases = [_corrected(c, corrections.get(c.id)) for c in cases]
    spent = sum(s.stop - s.start for r in recorded for s in r.episode.segments if s.kind == "intervention")
    return Harvested(tuple(cases), tuple(chosen), tuple(recorded), spent / world.control_hz)


def demonstrate(scenes: Sequence[SceneSpec], recipe: Recipe, *, twin: int, generation: int, folder: Path,
                software: Mapping[str, str]) -> list[Recorded]:
    """Whole demonstrations on the twin by the same stand-in with the same eyes: what the control arms learn from."""
    world = twin_world(draw_twin(twin), scenes, threads=recipe.threads)
    config = recipe.harvest.model_copy(update={"operator_delay_ticks": 0})
    operator = Operator(world, config, [s.seed for s in scenes])
    operator.reset(world.n)
    tracer = Tracer(world)
    rollout(world, operator, tracer=tracer)
    traces = tracer.traces()
    episodes = [
        Episode(id=episode_id("scripted", scene, "demonstrated", generation), origin="scripted", scene=scene,
                control_hz=trace.hz, frames=len(trace), generation=generation,
                outcome=_seen(trace, load_task(recipe.task).within_m),
                segments=(Segment(kind="demonstration", start=0, stop=len(trace), actor=OPERATOR),))
        for scene, trace in zip(scenes, traces, strict=True)
    ]
    return record(folder, world.setup, episodes, traces, config=config.model_dump(), software=software)


def _taken(episode: Episode, trace: Trace, case: HardCase, config: HarvestConfig) -> Attempt:
    """The attempt as it is when somebody takes over: to its end, or rewound where the oracle corrects.

    A judged case is taken over where both policies still stood alike: on a robot somebody sets the start up again
    and has the recorded commands played to that moment, which on the twin gives the recorded state itself.
    In the same way a correction that is aimed at the subtask begins where that began.
    """
    stop = len(trace) - config.rewind_ticks if config.oracle else len(trace)
    if config.aim == "subtask" and case.begins is not None:
        stop = min(stop, case.begins)
    stop = max(1, stop if case.judgement is None else case.tick)
    return episode, trace_slice(trace, stop)


def trace_slice(trace: Trace, stop: int) -> Trace:
    """The first `stop` ticks of a trace, shadows and signals left behind."""
    arrays = {n: getattr(trace, n)[:stop] for n in _ARRAYS}
    return replace(trace, **arrays, phase=trace.phase[:stop], shadows={}, signals={},
                   reward={k: v[:stop] for k, v in trace.reward.items()},
                   events=tuple(e for e in trace.events if e.tick < stop))


_ARRAYS = ("state", "environment", "action", "joint_action", "joint_velocity", "joint_effort", "link_poses",
           "sim_state", "controller")


def _restored(taken: Sequence[Attempt], recipe: Recipe, twin: int) -> World:
    """The robots as they stand after the last recorded action: the last tick is restored and played again."""
    world = twin_world(draw_twin(twin), [e.scene for e, _ in taken], threads=recipe.threads)
    ids = np.arange(world.n)
    world.load(ids, np.stack([t.sim_state[-1] for _, t in taken]),
               np.stack([t.controller[-1, :CONTROLLER_WIDTH] for _, t in taken]))
    world.act(np.stack([t.action[-1] for _, t in taken]), ids)
    world.restart_clock(ids)
    return world


def _joined(episode: Episode, before: Trace, after: Trace, delay: int, origin: Origin, generation: int,
            within_m: float) -> Attempt:
    """Attempt and correction as one episode: the policy's part, the operator's reaction, the intervention."""
    n, reacts = len(before), min(delay, len(after) - 1)
    width = max(before.controller.shape[1], after.controller.shape[1])  # policy and operator remember differently
    arrays = {name: np.concatenate([getattr(before, name), getattr(after, name)]) for name in _ARRAYS[:-1]}
    controller = np.concatenate([np.pad(t.controller, ((0, 0), (0, width - t.controller.shape[1])))
                                 for t in (before, after)])
    note = Event(n + reacts, 20, "intervention", f"{OPERATOR} takes over")
    trace = replace(
        before, **arrays, controller=controller, phase=(*before.phase, *["correct"] * len(after)),
        reward={k: np.concatenate([before.reward[k], after.reward[k]]) for k in before.reward},
        events=(*before.events, note))
    took_over = n + reacts
    joined = Episode(
        id=episode_id(origin, episode.scene, episode.id, n), origin=origin, scene=episode.scene,
        control_hz=episode.control_hz, frames=len(trace), parent=episode.id, transform="correction",
        policy=episode.policy, generation=generation, consent=episode.consent,
        outcome=_seen(trace, within_m).model_copy(update={"trigger": episode.outcome.trigger,
                                                          "family": episode.outcome.family,
                                                          "tick": episode.outcome.tick}),
        segments=(Segment(kind="autonomous", start=0, stop=took_over, actor=episode.policy or "policy"),
                  Segment(kind="intervention", start=took_over, stop=len(trace), actor=OPERATOR)))
    return joined, trace


def _seen(trace: Trace, within_m: float) -> Outcome:
    """What the operator says at the end: the object lies on the mark, let go; as perceived, not as simulated."""
    seen, state = trace.environment[-1], trace.state[-1]
    on_mark = np.hypot(*(seen[:2] - seen[4:6])) < within_m
    let_go = state[6] > 0.06 and np.linalg.norm(state[7:10] - seen[:3]) > 0.05
    label: Literal["success", "failure"] = "success" if on_mark and let_go else "failure"
    return Outcome(label=label, judged_by="operator")


def _corrected(case: HardCase, correction: Episode | None) -> HardCase:
    if correction is None:
        return case
    return case.model_copy(update={"correction": correction.id, "corrected": correction.outcome.label == "success"})
