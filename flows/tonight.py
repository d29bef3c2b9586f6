"""A night: the next lap of one lasting loop, judged by the nightly gate on its part of the year's error budget."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from prefect import flow

from flows.loop import opened, scheduled_day, show
from flows.run.opening import FIRST_HELD_OUT_TWIN
from flows.service import tasks
from flows.service.estimate import night_steps

TASKS: Mapping[str, Callable[[int], tuple[str, ...]]] = MappingProxyType({
    "collect": tasks.collect, "deploy": tasks.deploy, "harvest": tasks.harvest, "augment": tasks.augment,
    "build": tasks.build, "train": tasks.train, "gate": tasks.gate, "release": tasks.release, "exam": tasks.exam,
    "judge": tasks.judge, "worth": tasks.worth})


@flow(name="closed-loop", persist_result=False, result_serializer="json", validate_parameters=False)
def tonight(recipe: str = "nightly", seed: int = 0, twin: int = FIRST_HELD_OUT_TWIN, day: int | None = None,
            store: str | None = None) -> str:
    """Put the champion to work, learn from its failures, and ask the gate whether tonight's candidate may follow it.

    A night that was cut off is gone on with by the next one; every night of one run draws scenes of its own and from
    one budget.

    Args:
        recipe: name of a recipe in datasets/recipes, or a path, with a `nightly` gate.
        seed: seed of the lasting run: data, trainings and scenes of all nights.
        twin: seed of the simulated real robot.
        day: number of the day; None takes that of the scheduled start, 1970-01-01 being 0.
        store: folder of the store; None means HARDCASE_STORE or datasets/store.

    Returns:
        Path of the report.
    """
    with opened(recipe, None, seed, twin, False, store) as now:
        now.steps.day = scheduled_day() if day is None else day
        for step in night_steps(now.steps.tonight(), now.steps.recipe):
            TASKS[step.stage](step.generation)
        (page,) = tasks.report(now.steps.tonight() - 1)
        show(now.steps, page)
        return page
