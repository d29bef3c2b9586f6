"""Judge: where a candidate disagreed with the champion at work, both go on from that moment on the twin."""

from collections.abc import Sequence

import numpy as np

from pipeline.counterfactual.judging import Attempt, Named, gains_from_start
from pipeline.counterfactual.judging import judge as judge_in
from pipeline.counterfactual.moment import Lab
from pipeline.counterfactual.ride import Restorable
from pipeline.counterfactual.summary import FromStart, Subject, summarize
from pipeline.twin.twin import draw_twin, twin_setup
from schemas.counterfactual import JudgeConfig, ShadowReport
from schemas.recipe import Recipe

FROM_START_DRAWS = 2
"""Draws of an attempt that is played from its first tick: more attempts say more than more draws of one."""


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
    n = min(config.checked, len(attempts))
    rng = np.random.default_rng([config.seed, 23])
    picked: list[int] = sorted(rng.choice(len(attempts), n, replace=False).tolist())
    start = None
    if picked:
        few = config.model_copy(update={"draws": FROM_START_DRAWS})
        start = FromStart(picked, gains_from_start([attempts[i] for i in picked], *who, robot.draws, lab, few,
                                                   recipe.harvest))
    return summarize(subject, attempts, judged, start, config)
