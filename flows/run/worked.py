"""What the manifests of exam and deployment keep, whatever robot it was."""

from collections.abc import Callable, Mapping

import numpy as np
from pydantic import JsonValue

from flows.run import summary
from flows.run.arm_run import ArmRun, Made, no_rows
from flows.run.steps_api import Progress
from pipeline.deployed import Deployed
from pipeline.exam import ExamResult
from schemas.verdict import Proportion

type Sit = Callable[[str], tuple[ExamResult, Mapping[str, Proportion]]]
"""Policy -> its exam, and success by kind of start."""


def examined(run: ArmRun, generation: int, progress: Progress, sit: Sit,
             says: Callable[[Proportion], str]) -> Made:
    """Champion and candidate on the starts that no decision reads; a policy sits its exam once.

    Args:
        run, generation, progress: as every stage has them.
        sit: lets a policy sit the exam.
        says: of the champion's success at the deployment mix, a line for people.
    """
    champion, candidate = run.champion(generation), run.candidate(generation)
    results = dict(run.material.exams())
    fresh = [p for p in dict.fromkeys((champion, candidate)) if p not in results]
    for k, policy in enumerate(fresh):
        results[policy] = _graded(*sit(policy))
        progress(k + 1, len(fresh))
    mix = summary.proportions(results[champion])["deployment_mix"]
    return Made((champion,), says(mix), {"champion": champion, "candidate": candidate,
                                         "results": {p: results[p] for p in {champion, candidate}}}, no_rows)


def _graded(done: ExamResult, success: Mapping[str, Proportion]) -> dict[str, JsonValue]:
    """An exam as its manifest keeps it."""
    return {
        "bits": "".join("01"[int(s)] for s in done.success), "strata": list(done.strata),
        "rewards": {n: [round(float(v), 5) for v in c if np.isfinite(v)] for n, c in done.rewards.items()},
        "success": {kind: p.model_dump() for kind, p in success.items()}}


def worked(done: Deployed) -> dict[str, JsonValue]:
    """A deployment as its manifest keeps it."""
    numbers: dict[str, JsonValue] = {
        "robot_s": done.robot_s, "truth": "".join("01"[int(t)] for t in done.truth),
        "disagreement": [None if np.isnan(d) else round(float(d), 5) for d in done.disagreement]}
    if done.shadows:
        numbers["shadows"] = dict(done.shadows)
    if done.signals:
        numbers["signals"] = {name: {kind: [*values] for kind, values in kinds.items()}
                              for name, kinds in done.signals.items()}
    return numbers
