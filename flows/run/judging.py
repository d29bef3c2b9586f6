"""Judging: recorded deployments of a champion against any candidate, and the shadow report that comes of it."""

from collections.abc import Sequence

from flows.run.arm_run import ArmRun
from pipeline.counterfactual.estimate_log import SensedLog
from pipeline.counterfactual.judging import Attempt
from pipeline.counterfactual.ride import Restorable
from pipeline.counterfactual.summary import Subject
from pipeline.errors import PolicyError
from schemas.counterfactual import JudgeConfig, ShadowReport
from stages.estimate import estimate
from stages.judge import judge


def judged_at(run: ArmRun, generation: int, champion: str, candidate: str,
              config: JudgeConfig) -> tuple[list[Attempt], ShadowReport]:
    """The attempts of a lap's deployment, and what a candidate would have changed in them.

    Raises:
        StoreError: the lap was not deployed, or there is no such policy.
        ConsentError: somebody in an attempt did not consent to being learnt from.
    """
    attempts = run.material.deployed_attempts(generation)
    return attempts, judge(attempts, restorable(run, champion), restorable(run, candidate), run.recipe,
                           subject=subject_of(run, generation, champion, candidate), config=config)


def sensed_at(run: ArmRun, generation: int, champion: str, candidate: str, config: JudgeConfig) -> ShadowReport:
    """As judged_at, from what the robot sensed alone; the report says that it is estimated.

    Raises:
        StoreError, ConsentError: as judged_at.
        RecordingError: the robot does not sense what is needed.
    """
    attempts = [(e, SensedLog.of(trace, f"episode {e.id}")) for e, trace in run.material.deployed_attempts(generation)]
    return estimate(attempts, restorable(run, champion), restorable(run, candidate), run.recipe,
                    subject=subject_of(run, generation, champion, candidate), config=config)


def restorable(run: ArmRun, id: str) -> Restorable:
    """A policy ready to go on from any moment.

    Raises:
        PolicyError: its kind cannot be put back to a moment.
    """
    policy = run.policy(id)
    if not isinstance(policy, Restorable):
        raise PolicyError(f"a policy of kind {run.store.policy(id).kind!r} cannot be put back to a moment",
                          where=f"policy {id}", mend="judge policies of kind 'chunked'")
    return policy


def subject_of(run: ArmRun, generation: int, champion: str, candidate: str) -> Subject:
    """What a report says it is about; a candidate released before the champion is a former one."""
    released: Sequence[str] = [r.policy for r in run.store.releases(run.run)]
    earlier = released[:released.index(champion)] if champion in released else ()
    return Subject(run.run, generation, run.twin, champion, candidate, candidate in earlier)
