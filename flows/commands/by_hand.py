"""One stage at a time, for people at a terminal: the flow's own steps, without Prefect."""

from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from flows.run.opening import Order, open_order, order_of, recall
from flows.run.steps_api import StepResult
from pipeline.errors import ConfigError
from pipeline.store import store_root


def run_stage(
    stage: str,
    *,
    run: str | None = None,
    recipe: str | None = None,
    seed: int | None = None,
    twin: int | None = None,
    policy: str | None = None,
) -> dict[str, Any]:
    """Run one stage of the current generation of a run.

    The run is the one named, the one that recipe, policy, seed and twin say, or the newest of the store; to train, the
    newest that trains that policy.

    Returns:
        stage, generation, ids, says, resumed.

    Raises:
        HardcaseError: no such run, or the stage refused.
    """
    if stage == "train" and policy is not None and recipe is None:
        order = recall(store_root(), run, policy)
    else:
        order = _order(run, recipe, seed, twin, policy)
    with open_order(order, store_root()) as steps, stage_bar(stage) as bar:
        task = bar.add_task(stage, total=None)

        def progress(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        generation = steps.current(stage)
        result = steps.report(progress) if stage == "report" else getattr(steps, stage)(generation, progress)
    return _told(stage, generation, result)


def roll_back(*, run: str | None = None) -> dict[str, Any]:
    """Move the champion pointer of a run back by one."""
    with open_order(_order(run, None, None, None), store_root()) as steps:
        return _told("release", steps.current("release"), steps.rollback())


def _order(run: str | None, recipe: str | None, seed: int | None, twin: int | None,
           policy: str | None = None) -> Order:
    if not any(option is not None for option in (recipe, seed, twin, policy)):
        return recall(store_root(), run)
    if run is not None:
        raise ConfigError(
            "a run already has its recipe, seed and twin",
            where=f"--run {run}",
            mend="give either --run, or --recipe, --seed and --twin",
        )
    return order_of(recipe, None, seed, twin, policy=policy)


def _told(stage: str, generation: int, result: StepResult) -> dict[str, Any]:
    return {
        "stage": stage,
        "generation": generation,
        "ids": list(result.ids),
        "says": result.says,
        "resumed": result.resumed,
    }


def stage_bar(stage: str) -> Progress:
    """A bar on a terminal, nothing elsewhere."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
