"""From what a person ordered to the stages of one run: recipe, store, lock, steps."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from flows.steps_api import LoopSteps
from pipeline.errors import ConfigError, StoreError
from pipeline.recipes import load_recipe, recipe_from
from pipeline.store import RunInfo, Store
from schemas.recipe import Recipe

FIRST_HELD_OUT_TWIN = 100
"""Everything is tuned on twins 0-9; figures come from twins 100-119."""


@dataclass(frozen=True, slots=True)
class Order:
    """One loop as it was asked for."""

    recipe: Recipe
    seed: int = 0
    twin: int = FIRST_HELD_OUT_TWIN
    control: bool = False


def order_of(
    recipe: str | None, generations: int | None, seed: int | None, twin: int | None, *, control: bool = False
) -> Order:
    """An order out of options; None is the default of each.

    Raises:
        ConfigError: no such recipe, or a value that breaks a rule.
    """
    loaded = load_recipe(recipe or "default")
    if generations is not None:
        loaded = recipe_from(loaded.model_dump() | {"generations": generations}, f"--generations {generations}")
    return Order(loaded, seed or 0, FIRST_HELD_OUT_TWIN if twin is None else twin, control)


def recall(root: Path, run: str | None = None) -> Order:
    """The order of a run that was begun in this store: of the newest one by default.

    Raises:
        StoreError: there is no store, nothing was begun in it, or not this run; the known ones are listed.
    """
    with Store.open(root) as store:
        runs = store.runs()
        loops = {id: info for id, info in runs.items() if not info.control}
        if run is None:
            invoked = [str(id) for (id,) in store.query("SELECT run FROM invocation ORDER BY rowid DESC")]
            run = next((id for id in invoked if id in loops), None)
        if run not in loops:
            what = f"no run {run}" if run else "no run was begun here"
            mend = f"use one of: {', '.join(loops)}" if loops else "begin one: hardcase loop"
            raise StoreError(what, where=root, mend=mend)
        info = loops[run]
    control = any(_same_numbers(info, other) for other in runs.values() if other.control)
    return Order(recipe_from(dict(info.recipe), f"run {run} of {root}"), info.seed, info.twin, control)


def _same_numbers(one: RunInfo, other: RunInfo) -> bool:
    return (one.recipe, one.seed, one.twin) == (other.recipe, other.seed, other.twin)


def open_order(order: Order, root: Path) -> AbstractContextManager[LoopSteps]:
    """Open the store under its lock and wire the stages to it; imported late, they bring MuJoCo and torch along.

    Raises:
        ConfigError: the recipe names a robot, scene or task that there is not; every valid name is listed.
        StoreError: another loop holds the store, or it cannot be used.
    """
    check_names(order.recipe)
    from flows.steps import open_run

    return open_run(root, order.recipe, seed=order.seed, twin=order.twin, control=order.control)


def check_names(recipe: Recipe) -> None:
    """Refuse names that are in no table, before anything is begun."""
    from pipeline.simulation.bodies import ROBOTS
    from pipeline.simulation.scenes import SCENES
    from pipeline.simulation.tasks import TASKS

    tables = (("robot", recipe.robot, ROBOTS), ("scene", recipe.scene, SCENES), ("task", recipe.task, TASKS))
    for kind, name, table in tables:
        if name not in table:
            raise ConfigError(
                f"unknown {kind} {name!r}",
                where=f"recipe {recipe.name}, {kind}",
                mend=f"use one of: {', '.join(sorted(table))}",
            )
