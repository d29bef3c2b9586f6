"""The loop's verbs as Prefect tasks: each wraps one stage, takes a generation, hands back ids.

The store's manifests decide what is finished, so Prefect neither caches nor
keeps results (its default would pickle them); even a failure is noted as JSON.
"""

from collections.abc import Callable

from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.runtime import task_run

from flows.run.steps_api import LoopSteps, Progress, StepResult
from flows.service.memory import give_back
from flows.service.running import Step, running

type Ids = tuple[str, ...]


def _name() -> str:
    """'gate 2' or 'control gate 2': what Prefect's page calls the run of a task."""
    active, parameters = running(), task_run.get_parameters() or {}
    words = [
        active.arm if active and active.arm != "loop" else "",
        task_run.get_task_name() or "",
        parameters.get("generation"),
    ]
    return " ".join(str(word) for word in words if word not in ("", None))


def _stage(function: Callable[[int], Ids]) -> Task[[int], Ids]:
    """The task of one stage."""
    wrap = task(task_run_name=_name, persist_result=False, result_serializer="json", cache_policy=NO_CACHE)
    return wrap(function)


def _run(stage: str, generation: int, pick: Callable[[LoopSteps], Callable[[int, Progress], StepResult]]) -> Ids:
    """Run one stage of the active arm under the eyes of its watcher."""
    active = running()
    if active is None:
        raise RuntimeError(f"task {stage!r} was called outside of closed_loop")
    active.check()
    step = Step(active.arm, generation, stage)
    active.watcher.begin(step)
    result = pick(active.steps)(generation, active.watcher.advance)
    give_back()
    active.watcher.end(step, result)
    return result.ids


@_stage
def collect(generation: int) -> Ids:
    """Demonstrations by the scripted expert."""
    return _run("collect", generation, lambda steps: steps.collect)


@_stage
def augment(generation: int) -> Ids:
    """Variants of what is new."""
    return _run("augment", generation, lambda steps: steps.augment)


@_stage
def build(generation: int) -> Ids:
    """The dataset version."""
    return _run("build", generation, lambda steps: steps.build)


@_stage
def train(generation: int) -> Ids:
    """The candidate."""
    return _run("train", generation, lambda steps: steps.train)


@_stage
def gate(generation: int) -> Ids:
    """The verdict on the candidate."""
    return _run("gate", generation, lambda steps: steps.gate)


@_stage
def release(generation: int) -> Ids:
    """The champion after the verdict."""
    return _run("release", generation, lambda steps: steps.release)


@_stage
def exam(generation: int) -> Ids:
    """What no decision reads: the champion on the same twin starts each generation."""
    return _run("exam", generation, lambda steps: steps.exam)


@_stage
def deploy(generation: int) -> Ids:
    """Robot time."""
    return _run("deploy", generation, lambda steps: steps.deploy)


@_stage
def harvest(generation: int) -> Ids:
    """Hard cases and their corrections."""
    return _run("harvest", generation, lambda steps: steps.harvest)


@_stage
def judge(generation: int) -> Ids:
    """Who was right where the newest candidate would have acted otherwise in the last deployment."""
    return _run("judge", generation, lambda steps: steps.judge)


@_stage
def worth(generation: int) -> Ids:
    """What the last lap's new episodes were worth, by one extra training."""
    return _run("worth", generation, lambda steps: steps.worth)


@_stage
def report(generation: int) -> Ids:
    """The page that shows it all."""
    return _run("report", generation, lambda steps: lambda _, progress: steps.report(progress))
