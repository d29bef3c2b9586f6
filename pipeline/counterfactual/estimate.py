"""Estimate: who was right, told for a real robot: its state is estimated from what it sensed, in a stand-in for it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from pipeline.counterfactual.branches import branch
from pipeline.counterfactual.estimate_log import SensedLog, perceived_scene
from pipeline.counterfactual.estimate_robot import Robot, identify
from pipeline.counterfactual.estimate_state import Guessed, Sought, guess
from pipeline.counterfactual.judging import Case, Judged, Named, judge_by
from pipeline.counterfactual.moment import Beginning, Lab, Start
from pipeline.counterfactual.ride import ride
from pipeline.counterfactual.windows import Window
from pipeline.files import short_id
from pipeline.protocols import Array
from pipeline.simulation.physics import UNITS, Physics
from pipeline.simulation.tasks import load_task, scene_seed
from schemas.counterfactual import JudgeConfig
from schemas.episode import Episode
from schemas.recipe import HarvestConfig
from schemas.scene import Draw

type Sensed = tuple[Episode, SensedLog]

JOINTS_RAD, OBJECT_M = 0.05, 0.015
"""Replay errors above which a moment is refused: RMS of the joints [rad], and of the perceived object [m]."""

TOO_LATE = "it lies beyond the time that the task allows"


@dataclass(frozen=True, slots=True)
class Estimated:
    """A moment whose state is estimated; a Beginning. Every branch begins from a guess of its own."""

    episode: Episode
    """With the start as it was perceived: the truth of a real attempt is nobody's to know."""
    trace: SensedLog
    window: Window
    champion: Array
    candidate: Array
    guessed: Guessed

    @property
    def tick(self) -> int:
        """Where both policies go on."""
        return self.window.start

    def start(self, branch: int, seed: int) -> Start:
        """One of the guesses."""
        del seed
        row = branch % len(self.guessed.engine)
        return Start(_draws(self.guessed.physics, row), self.guessed.engine[row], self.guessed.controller[row])


def judge_estimated(attempts: Sequence[Sensed], champion: Named, candidate: Named, robot: Robot, lab: Lab,
                    config: JudgeConfig, triggers: HarvestConfig) -> Judged:
    """As judging.judge, from sensors alone. The judgements say that they are estimated, and their replay errors.

    Args:
        attempts: of the champion, whole.
        champion, candidate: the candidate need not have ridden along.
        robot: what is believed of the robot, see identified.
        lab: the simulation that stands in for it.
        config: what counts as a disagreement, how many draws.
        triggers: thresholds that were in force at work.
    """
    errors: dict[str, Guessed] = {}

    def restore(cases: Sequence[Case[SensedLog]]) -> Sequence[Beginning | str]:
        moments = estimated(cases, robot, lab, config)
        errors.update({m.episode.id: m.guessed for m in moments if isinstance(m, Estimated)})
        return moments

    judged = judge_by(restore, attempts, champion, candidate, lab, config, triggers)
    marked = [j.model_copy(update={
        "id": short_id("estimated", j.id), "estimated": True, "replay_error_m": errors[j.episode].object_m,
        "replay_error_rad": errors[j.episode].joints_rad}) for j in judged.judgements]
    return Judged(judged.apart, judged.windows, tuple(marked), judged.weights, judged.refusals)


def gains_from_start_estimated(attempts: Sequence[Sensed], champion: Named, candidate: Named, robot: Robot, lab: Lab,
                               config: JudgeConfig, triggers: HarvestConfig) -> Array:
    """As judging.gains_from_start, from sensors alone."""
    logs = [log for _, log in attempts]
    acted, would = (ride(named.policy, logs, ticks=1) for named in (champion, candidate))
    cases = [Case(e, log, Window(0, 1, 0.0), a, b)
             for (e, log), a, b in zip(attempts, acted, would, strict=True)]
    moments = [m for m in estimated(cases, robot, lab, config) if isinstance(m, Estimated)]
    played = branch(moments, champion.policy, candidate.policy, lab, config, triggers)
    return np.array([b.success[1].mean() - b.success[0].mean() for b in played])


def identified(attempts: Sequence[Sensed], lab: Lab, seed: int) -> Robot:
    """What is believed of the robot of these attempts.

    Args:
        attempts: of one robot, at least one.
        lab: the simulation that stands in for it.
        seed: of all draws.
    """
    episode, log = attempts[0]
    return identify([log for _, log in attempts], perceived_scene(episode.scene, log, 0), lab, seed)


def estimated(cases: Sequence[Case[SensedLog]], robot: Robot, lab: Lab, config: JudgeConfig) -> list[Estimated | str]:
    """The moments of cases, or why one is refused."""
    if not cases:
        return []
    episodes = [_as_perceived(c, config) for c in cases]
    within = [c.window.start < load_task(e.scene.task).ticks for c, e in zip(cases, episodes, strict=True)]
    sought = [Sought(e.scene, c.log, c.window.start) for c, e, ok in zip(cases, episodes, within, strict=True) if ok]
    guesses = iter(guess(sought, robot, lab))
    return [_checked(Estimated(e, c.log, c.window, c.champion.memory[c.window.start],
                               c.candidate.memory[c.window.start], next(guesses))) if ok else TOO_LATE
            for c, e, ok in zip(cases, episodes, within, strict=True)]


def _as_perceived(case: Case[SensedLog], config: JudgeConfig) -> Episode:
    seed = scene_seed("study", int(case.episode.id, 16), case.window.start, config.seed)
    scene = perceived_scene(case.episode.scene, case.log, seed)
    return case.episode.model_copy(update={"scene": scene})


def _checked(moment: Estimated) -> Estimated | str:
    """Refuse what the stand-in does not reproduce."""
    found = moment.guessed
    if found.joints_rad > JOINTS_RAD:
        return (f"replay misses the joints by {found.joints_rad:.3f} rad (RMS), more than {JOINTS_RAD:g}: "
                "the stand-in moves unlike the robot")
    if found.object_m > OBJECT_M:
        return (f"replay misses the object by {1000 * found.object_m:.1f} mm (RMS), more than {1000 * OBJECT_M:g}: "
                "something happened that the sensors do not tell")
    return moment


def _draws(physics: Physics, row: int) -> tuple[Draw, ...]:
    return tuple(Draw(name=f.name, unit=UNITS[f.name], value=float(getattr(physics, f.name)[row]))
                 for f in fields(physics))
