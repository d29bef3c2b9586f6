"""The deployment side of a lap: exam, deployment, harvest, and what control arms do in its place."""

from collections.abc import Sequence

import numpy as np

from flows.run import facts, worked
from flows.run.arm_run import ArmRun, Made, no_rows
from flows.run.judging import judged_at
from flows.run.mining import mined_at
from flows.run.seeing import filmed, sight_of
from flows.run.signalling import neighbours_of
from flows.run.steps_api import Progress
from pipeline.counterfactual.cases import cases_of
from pipeline.shadow.riders import Riders
from pipeline.simulation.recordings import Recorded
from pipeline.store import Transaction
from schemas.hardcase import HardCase
from schemas.scene import SceneSpec
from schemas.verdict import Proportion
from stages.deploy import deploy, deploy_scenes
from stages.exam import ExamResult, exam, success_by
from stages.harvest import Attempt, Harvested, demonstrate, hard_cases, harvest
from stages.mine import Mined

OTHER_STARTS = 500_000
"""Added to the seed of a control arm's random starts, so that they are none of the loop's."""
DEMONSTRATION_S = 2
"""Shortest demonstration that is planned for where robot time is the limit [s]."""


def examined(run: ArmRun, generation: int, progress: Progress) -> Made:
    """Champion and candidate on the starts that no decision reads; a policy sits its exam once."""
    def sit(policy: str) -> tuple[ExamResult, dict[str, Proportion]]:
        done = exam(run.policy(policy), run.recipe, seed=run.seed, twin=run.twin)
        return done, success_by(done.success, done.strata, run.recipe)

    return worked.examined(run, generation, progress, sit, lambda mix: (
        f"champion {mix.rate:.3f} [{mix.low:.3f} {mix.high:.3f}] at the deployment mix"))


def deployed(run: ArmRun, generation: int) -> Made:
    """The champion at work."""
    if not run.arm.deploys:
        return Made((), "this arm does not deploy", {"robot_s": 0.0}, no_rows)
    champion = run.champion(generation)
    config = run.recipe.deploy
    others = run.material.riders(champion, config.riders) if config.shadow else []
    with Riders({id: run.file(id) for id in others}, patient=True) as riders:
        policy = run.policy(champion)
        done = deploy(policy, champion, run.recipe, seed=run.seed, twin=run.twin, generation=generation,
                      folder=run.folder(), software=facts.software("deploy"), riders=riders,
                      neighbours=neighbours_of(champion, run.store) if config.shadow else None,
                      sight=sight_of(policy, run.twin))
    flagged = sum(r.episode.outcome.label == "failure" for r in done.recorded)
    says = f"{flagged} of {len(done.recorded)} attempts flagged by the robot"
    return run.recorded(filmed(done.recorded, run.recipe, run.twin), says, worked.worked(done))


def harvested(run: ArmRun, generation: int, progress: Progress) -> Made:
    """Hard cases and corrections, or what a control arm gets in their place."""
    new = run.arm.new_data
    if new == "none":
        return Made((), "this arm learns nothing new", {"robot_s": 0.0, "asked": 0, "cases": []}, no_rows)
    if new in ("random", "random-seconds"):
        return _at_random_starts(run, generation, same_seconds=new == "random-seconds")
    attempts, judged = _to_correct(run, generation)
    cases = hard_cases(attempts, generation, run.name) if judged is None else judged
    told = mined_at(run, generation, cases, attempts)
    done = harvest(attempts, run.recipe, twin=run.twin, generation=generation, folder=run.folder(),
                   software=facts.software("harvest"), arm=run.name, progress=progress, judged=told.cases,
                   ranked=[place.case for place in told.queue], record_corrections=new == "corrections")
    return _corrected(run, done, told) if new == "corrections" else _at_failed_starts(run, generation, attempts, done)


def _to_correct(run: ArmRun, generation: int) -> tuple[list[Attempt], list[HardCase] | None]:
    """Attempts that a trigger stopped; or all of them, and the moments at which somebody was judged wrong."""
    config = run.recipe.harvest.judge
    if config is None:
        return run.material.failed_attempts(generation), None
    champion = run.champion(generation)
    riders = run.material.riders(champion, 1)
    if not riders:  # the first lap has nobody to disagree with
        return run.material.failed_attempts(generation), None
    attempts, report = judged_at(run, generation, champion, riders[0], config)
    return attempts, cases_of(report.judgements, generation, run.name)


def _corrected(run: ArmRun, done: Harvested, told: Mined) -> Made:
    good = sum(c.corrected for c in done.cases)
    recorded = filmed(done.recorded, run.recipe, run.twin)
    new = f", new: {', '.join(f.name for f in told.new)}" if told.new else ""
    made = run.recorded(recorded, f"{len(done.cases)} hard cases, {good} of {len(done.recorded)} corrected{new}",
                        {"robot_s": done.robot_s, "asked": len(done.recorded), "cases": [c.id for c in done.cases]})

    def write(tx: Transaction) -> None:
        made.write(tx)
        tx.add_families(told.new)
        tx.add_hard_cases(done.cases)

    return Made(made.ids, made.says, made.numbers, write)


def _at_failed_starts(run: ArmRun, generation: int, attempts: Sequence[Attempt], done: Harvested) -> Made:
    scenes = {episode.id: episode.scene for episode, _ in attempts}
    return _demonstrated(run, generation, [scenes[case.episode] for case in done.chosen])


def _at_random_starts(run: ArmRun, generation: int, *, same_seconds: bool) -> Made:
    """Demonstrations where the loop would deploy: as many as it corrects, or as many as fit into its robot time."""
    count, budget = run.recipe.harvest.corrections, None
    if same_seconds and run.base is not None:
        budget = run.base.robot_seconds(generation)
        count = max(count, int(budget / DEMONSTRATION_S))
    recipe = run.recipe.model_copy(update={"deploy": run.recipe.deploy.model_copy(update={"episodes": count})})
    starts = deploy_scenes(recipe, seed=run.seed + OTHER_STARTS, twin=run.twin, generation=generation)
    return _demonstrated(run, generation, starts, budget)


def _demonstrated(run: ArmRun, generation: int, starts: Sequence[SceneSpec], budget_s: float | None = None) -> Made:
    recorded: list[Recorded] = []
    if starts:
        recorded = _within(demonstrate(starts, run.recipe, twin=run.twin, generation=generation, folder=run.folder(),
                                       software=facts.software("harvest")), budget_s)
        recorded = filmed(recorded, run.recipe, run.twin)
    seconds = sum(r.episode.duration_s for r in recorded)
    return run.recorded(recorded, f"{len(recorded)} demonstrations, {seconds:.0f} s",
                        {"robot_s": seconds, "asked": len(recorded), "cases": []})


def _within(recorded: list[Recorded], budget_s: float | None) -> list[Recorded]:
    """The first demonstrations that fit into the robot time; all where there is no limit."""
    if budget_s is None:
        return recorded
    spent = np.cumsum([r.episode.duration_s for r in recorded])
    return [r for r, s in zip(recorded, spent, strict=True) if s <= budget_s]
