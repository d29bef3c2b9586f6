"""The closed loop as a Prefect flow: it reads like the loop, aloud."""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from prefect import flow, get_run_logger
from prefect.artifacts import create_link_artifact, create_table_artifact
from prefect.runtime import flow_run

from flows.run.opening import FIRST_HELD_OUT_TWIN, open_order, order_of
from flows.run.steps_api import LoopSteps, StepResult
from flows.service.running import Running, Step, run_with, running
from flows.service.tasks import (
    augment,
    build,
    collect,
    deploy,
    exam,
    gate,
    harvest,
    judge,
    release,
    report,
    train,
    worth,
)
from pipeline.store import store_root
from schemas.summary import Generation


@flow(name="closed-loop", persist_result=False, result_serializer="json", validate_parameters=False)
def closed_loop(
    recipe: str = "default",
    generations: int | None = None,
    seed: int | None = 0,
    twin: int = FIRST_HELD_OUT_TWIN,
    control: bool = False,
    store: str | None = None,
) -> str:
    """Learn, prove, release, watch - and begin again from what went wrong.

    Args:
        recipe: name of a recipe in datasets/recipes, or a path.
        generations: laps after generation 0; None leaves it to the recipe.
        seed: seed of data and training; None takes the number of the scheduled day, for runs by the clock.
        twin: seed of the simulated real robot.
        control: also turn the same loop with random starts in place of the harvest.
        store: folder of the store; None means HARDCASE_STORE or datasets/store.

    Returns:
        Path of the report.
    """
    with opened(recipe, generations, seed, twin, control, store) as now:
        steps, last = now.steps, now.steps.recipe.generations
        in_full = steps.recipe.harvest.worth_seeds > 0
        turn(last, in_full=in_full)
        if steps.control is not None:
            with run_with(replace(now, steps=steps.control, arm="control")):
                turn(last, in_full=in_full)
        judge(last)
        if not in_full:
            worth(last)
        (page,) = report(last)
        show(steps, page)
        return page


def turn(last: int, *, in_full: bool) -> None:
    """Every lap of one arm, generation 0 to `last`; nothing is harvested that no lap would learn from.

    `in_full` judges what each lap added by retraining, before anything is released.
    """
    collect(0)
    for generation in range(last + 1):
        augment(generation)
        build(generation)
        if in_full and generation:
            worth(generation)
        train(generation)
        gate(generation)
        release(generation)
        exam(generation)
        if generation < last:
            deploy(generation)
            harvest(generation)


def show(steps: LoopSteps, page: str) -> None:
    """Leave the outcome where Prefect's page shows it: one table, one link."""
    rows = [_row(lap) for lap in steps.result().generations]
    create_table_artifact(table=rows, key="success-by-generation", description="Exam of each generation's champion")
    create_link_artifact(link=f"file://{page}", link_text="report", key="report")


class LogWatcher:
    """Tells Prefect's log what the stages return, when a worker runs the loop and no person watches."""

    def begin(self, step: Step) -> None:
        """Prefect's own states tell that."""

    def advance(self, done: int, total: int) -> None:
        """Too many for a log."""

    def end(self, step: Step, result: StepResult) -> None:
        """One line a stage."""
        get_run_logger().info("%s %d %s: %s", step.arm, step.generation, step.stage, result.says)


def _row(lap: Generation) -> dict[str, str | int]:
    success = {kind: f"{p.rate:.3f} [{p.low:.3f} {p.high:.3f}]" for kind, p in lap.success.items()}
    return {"generation": lap.generation, **success, "gate": lap.gate.verdict, "policy": lap.policy}


def scheduled_day() -> int:
    """Days from 1970 to the scheduled start of the running flow, UTC: the seed of a run by the clock."""
    return int(flow_run.get_scheduled_start_time().timestamp() // 86_400)


@contextlib.contextmanager
def opened(
    recipe: str, generations: int | None, seed: int | None, twin: int, control: bool, store: str | None
) -> Iterator[Running]:
    """The stages that the command line already opened, or, under a worker, opened here from the parameters."""
    if (active := running()) is not None:
        yield active
        return
    if seed is None:
        seed = scheduled_day()
    order = order_of(recipe, generations, seed, twin, control=control)
    with open_order(order, Path(store) if store else store_root()) as steps, run_with(
        Running(steps, LogWatcher())
    ) as active:
        yield active
