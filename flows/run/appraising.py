"""What a finished loop learns of its last lap: who was right where policies disagreed, and what its batch was worth."""

from flows.run.arm_run import ArmRun, Made, no_rows
from flows.run.judging import judged_at
from flows.run.steps_api import Progress
from flows.run.worth import indicated, judged_batch
from pipeline.policies.table import policy_kind
from schemas.counterfactual import JudgeConfig, ShadowReport
from schemas.summary import ShadowLine, WorthLine
from schemas.worth import BatchWorth

QUICK = JudgeConfig(most=16, checked=0)
"""As many disagreements as a few seconds judge; the whole form is `hardcase judge`."""


def judged(run: ArmRun, generation: int) -> Made:
    """The newest candidate against the champion that was last at work, by what happened there; all of it by night."""
    if generation == 0 or not run.material.ids(generation - 1, "deploy"):
        return Made((), "nothing was deployed", {}, no_rows)
    if policy_kind(run.recipe.train.policy).sees:
        return Made((), "policies that see cannot be put back to a moment", {}, no_rows)
    champion, candidate = run.material.ids(generation - 1, "release")[0], run.candidate(generation)
    config = QUICK if run.recipe.gate.nightly is None else JudgeConfig()
    _, report = judged_at(run, generation - 1, champion, candidate, config)
    line = shadow_line(report)
    return Made((), line.says, {"shadow": line.model_dump(mode="json")}, no_rows)


def worth_of(run: ArmRun, generation: int, progress: Progress) -> Made:
    """What the new episodes of a lap are worth: in full where the recipe asks for seeds, and that decides.

    Else those of the last lap that had any, by one extra training, which decides nothing.
    """
    if policy_kind(run.recipe.train.policy).sees:
        return Made((), "a batch is judged by policies that see the state", {}, no_rows)
    if seeds := run.recipe.harvest.worth_seeds:
        return judged_batch(run, generation, progress, seeds=seeds) or Made((), "nothing new to judge", {}, no_rows)
    laps = ((g, indicated(run, g)) for g in range(generation, 0, -1))
    lap, found = next(((g, found) for g, found in laps if found is not None), (0, None))
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
