"""Estimate: as judge, for a robot whose state nobody knows: from what it sensed, in the simulation of training."""

from collections.abc import Sequence

from pipeline.counterfactual.estimate import gains_from_start_estimated, identified, judge_estimated
from pipeline.counterfactual.estimate_log import SensedLog
from pipeline.counterfactual.judging import Named
from pipeline.counterfactual.moment import Lab
from pipeline.counterfactual.ride import Restorable
from pipeline.counterfactual.summary import Subject, from_start, summarize
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import compose
from schemas.counterfactual import JudgeConfig, ShadowReport
from schemas.episode import Episode
from schemas.recipe import Recipe


def estimate(attempts: Sequence[tuple[Episode, SensedLog]], champion: Restorable, candidate: Restorable,
             recipe: Recipe, *, subject: Subject, config: JudgeConfig) -> ShadowReport:
    """Judge recorded attempts of any robot, real ones included; no truth of a simulator is read, nor a twin's physics.

    The robot is identified from all of the attempts at once, the state at each disagreement from the attempt itself.

    Args:
        attempts: the champion's, as its robot sensed them.
        champion, candidate: the policies that `subject` names.
        recipe: robot and surroundings to stand in for the real ones, triggers that were in force, threads.
        subject: run, lap and ids.
        config: what counts as a lasting disagreement, and the number of draws.
    """
    lab = Lab(compose(load_body(recipe.robot), recipe.scene), recipe.threads)
    who = Named(subject.champion, champion), Named(subject.candidate, candidate)
    robot = identified(attempts, lab, config.seed)
    judged = judge_estimated(attempts, *who, robot, lab, config, recipe.harvest)
    start = from_start(attempts, config, lambda few, less: gains_from_start_estimated(
        few, *who, robot, lab, less, recipe.harvest))
    return summarize(subject, attempts, judged, start, config).model_copy(update={"estimated": True})
