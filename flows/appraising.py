"""What a finished loop learns of its last lap: who was right where policies disagreed, and what its batch was worth."""

from flows.arm_run import ArmRun, Made, no_rows
from flows.judging import judged_at
from flows.steps_api import Progress
from flows.worth import indicated, judged_batch
from pipeline.errors import ConfigError, PolicyError
from schemas.counterfactual import JudgeConfig, ShadowReport
from schemas.summary import ShadowLine, WorthLine
from schemas.worth import BatchWorth

QUICK = JudgeConfig(most=16, checked=0)
"""As many disagreements as a few seconds judge; the whole form is `hardcase judge`."""


def judged(run: ArmRun, generation: int) -> Made:
    """The newest candidate against the champion that was last at work, by what happened there; all of it by night."""
    if generation == 0 or not run.material.ids(generation - 1, "deploy"):
        return Made((), "nothing was deployed", {}, no_rows)
    champion, candidate = run.material.ids(generation - 1, "release")[0], run.candidate(generation)
    try:
        config = QUICK if run.recipe.gate.nightly is None else JudgeConfig()
        _, report = judged_at(run, generation - 1, champion, candidate, config)
    except PolicyError as error:
        return Made((), error.what, {}, no_rows)
    line = shadow_line(report)
    return Made((), line.says, {"shadow": line.model_dump(mode="json")}, no_rows)


def worth_of(run: ArmRun, generation: int, progress: Progress) -> Made:
    """What the new episodes of a lap are worth: in full where the recipe asks for seeds, and that decides.

    Else those of the last lap that had any, by one extra training, which decides nothing.
    """
    seeds = run.recipe.harvest.worth_seeds
    try:
        if seeds:
            return judged_batch(run, generation, progress, seeds=seeds) or Made((), "nothing new to judge", {}, no_rows)
        laps = ((g, indicated(run, g)) for g in range(generation, 0, -1))
        lap, found = next(((g, found) for g, found in laps if found is not None), (0, None))
    except ConfigError as error:
        return Made((), error.what, {}, no_rows)
    progress(1, 1)
    if found is None:
        return Made((), "no lap added anything", {}, no_rows)
    line = worth_line(found, lap)
    return Made((), line.says, {"worth": line.model_dump(mode="json")}, no_rows)


def shadow_line(report: ShadowReport) -> ShadowLine:
    """A shadow report in one line."""
    whole, change = report.rows[0], report.change
    return ShadowLine(champion=report.champion, candidate=report.candidate, agreement=report.agreement,
                      attempts=whole.attempts, apart=whole.apart, judged=whole.judged,
                      right={str(who): n for who, n in whole.right.items()}, undecided=whole.undecided,
                      change=None if change is None else (change.estimate, change.low, change.high),
                      verdict=report.verdict)


def worth_line(found: BatchWorth, generation: int) -> WorthLine:
    """A verdict on a batch in one line."""
    whole = found.parts[0]
    return WorthLine(generation=generation, batch=found.says, episodes=len(found.episodes),
                     points=100 * whole.difference, seeds=len(found.seeds_with), scenes=whole.scenes,
                     kinds={part.name: 100 * part.difference for part in found.parts[1:]})
