"""Judge: where a candidate disagreed with the champion at work, both go on from that moment on the twin."""

from collections.abc import Sequence

from pipeline.counterfactual.judging import Attempt, Named, gains_from_start
from pipeline.counterfactual.judging import judge as judge_in
from pipeline.counterfactual.moment import Lab
from pipeline.counterfactual.ride import Restorable
from pipeline.counterfactual.summary import Subject, from_start, summarize
from pipeline.twin.twin import draw_twin, twin_setup
from schemas.counterfactual import JudgeConfig, ShadowReport
from schemas.recipe import Recipe


def judge(attempts: Sequence[Attempt], champion: Restorable, candidate: Restorable, recipe: Recipe, *,
          subject: Subject, config: JudgeConfig) -> ShadowReport:
    """Judge recorded deployments of the champion against any candidate, whether or not it rode along.

    It runs in the twin's own physics, so it belongs to the deployment side: no training and no gate reads it.

    Args:
        attempts: the champion's, with their recordings, restorable.
        champion, candidate: the policies that `subject` names.
        recipe: the triggers that were in force, and threads.
        subject: run, lap, twin and ids.
        config: what counts as a lasting disagreement, and the number of draws.
    """
    robot = draw_twin(subject.twin)
    lab = Lab(twin_setup(robot, recipe.robot, recipe.scene), recipe.threads)
    who = Named(subject.champion, champion), Named(subject.candidate, candidate)
    judged = judge_in(attempts, *who, robot.draws, lab, config, recipe.harvest)
    start = from_start(attempts, config, lambda few, less: gains_from_start(
        few, *who, robot.draws, lab, less, recipe.harvest))
    return summarize(subject, attempts, judged, start, config)
