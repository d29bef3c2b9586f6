"""Mining: the failures of a run's laps told apart and put in order, wired to the store."""

from collections.abc import Sequence

import numpy as np

from flows.run.arm_run import ArmRun
from pipeline.mining.happened import Starts, start_of
from pipeline.protocols import Array
from pipeline.trace import Trace
from schemas.episode import VARIANTS, Episode
from schemas.hardcase import HardCase
from stages.mine import Before, Mined, mine, nowhere

type Attempt = tuple[Episode, Trace]


def mined_at(run: ArmRun, generation: int, cases: Sequence[HardCase], attempts: Sequence[Attempt],
             knew: Before | None = None) -> Mined:
    """The failures of a lap, by what the laps before it have shown.

    Args:
        run: one arm of one run.
        generation: of the lap.
        cases: its hard cases.
        attempts: at least those that the cases are about, with their recordings.
        knew: what earlier laps have shown, where it is not what the store says.
    """
    traces = {episode.id: trace for episode, trace in attempts}
    about = {case.episode for case in cases}
    others = [e for e in run.store.episodes(run.material.ids(generation, "deploy")) if e.id not in about]
    return mine(cases, traces, knew or before(run, generation), solved=_starts(run, run.material.usable(others)),
                generation=generation, run=run.run)


def before(run: ArmRun, generation: int) -> Before:
    """What is known when the failures of a lap are looked at."""
    earlier = [c for c in run.store.hard_cases(run=run.run) if c.generation < generation]
    made = [c for c in earlier if c.correction is not None]
    fixed = {s.hard_case for s in run.store.regression_scenes(run=run.run) if s.generation <= generation}
    tries: dict[str, tuple[int, int]] = {}
    for case in made:
        if case.found is not None:
            asked, ended = tries.get(case.found, (0, 0))
            tries[case.found] = asked + 1, ended + (case.id in fixed)
    families = [f for f in run.store.families(run=run.run) if f.generation < generation]
    corrected = _starts(run, run.store.episodes([c.episode for c in made]))
    return Before(tuple(families), taught(run, generation), corrected, tries)


def taught(run: ArmRun, generation: int) -> Starts:
    """Starts that the policy at work learnt from: simulated ones as they were, recorded ones as perceived."""
    attempts = run.material.ids(generation, "deploy")
    policy = run.store.episode(attempts[0]).policy if attempts else None
    if policy is None:
        return nowhere()
    gone = run.store.erased(ids := run.store.version(run.store.policy(policy).dataset).episodes)
    return _starts(run, run.store.episodes([e for e in ids if e not in gone]))


def _starts(run: ArmRun, episodes: Sequence[Episode]) -> Starts:
    rows = [_perceived(run, e) for e in episodes]
    return np.array(rows, np.float64).reshape(len(rows), 3)


def _perceived(run: ArmRun, episode: Episode) -> Array:
    scene = episode.scene
    if episode.origin in VARIANTS or scene.family == "demo":
        return np.array([*scene.object_xy_m, scene.object_half_m])
    return start_of(run.material.frames(episode).environment)
