"""Judge: where a candidate disagreed with the champion at work, both go on from that moment on the twin."""

from collections.abc import Sequence

from pipeline.counterfactual.judging import Attempt, Judged, Named
from pipeline.counterfactual.judging import judge as judge_in
from pipeline.counterfactual.moment import Lab
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.twin.twin import draw_twin, twin_setup
from schemas.counterfactual import JudgeConfig
from schemas.recipe import Recipe


def judge(attempts: Sequence[Attempt], champion: tuple[str, OnnxPolicy], candidate: tuple[str, OnnxPolicy],
          recipe: Recipe, *, twin: int, config: JudgeConfig) -> Judged:
    """Judge recorded deployments of the champion against any candidate, whether or not it rode along.

    It runs in the twin's own physics, so it belongs to the deployment side: no training and no gate reads it.

    Args:
        attempts: the champion's, with their recordings, restorable.
        champion, candidate: id and policy.
        recipe: the triggers that were in force, and threads.
        twin: seed of the twin that was recorded.
        config: what counts as a lasting disagreement, and the number of draws.
    """
    robot = draw_twin(twin)
    lab = Lab(twin_setup(robot, recipe.robot, recipe.scene), recipe.threads)
    return judge_in(attempts, Named(*champion), Named(*candidate), robot.draws, lab, config, recipe.harvest)
