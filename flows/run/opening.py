"""From what a person ordered to the stages of one run: recipe, store, lock, steps."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from flows.run.steps_api import LoopSteps
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


RECIPE_OF: Mapping[str, str] = MappingProxyType({"act": "act"})
"""Kind of policy -> recipe made for it, where that is not the default one."""


def order_of(
    recipe: str | None,
    generations: int | None,
    seed: int | None,
    twin: int | None,
    *,
    control: bool = False,
    policy: str | None = None,
) -> Order:
    """An order out of options; None is the default of each.

    Args:
        recipe: name or path; where none is given, the one made for the policy.
        generations: laps after generation 0.
        seed: of data and training.
        twin: seed of the simulated real robot.
        control: also turn the loop with random starts.
        policy: kind of policy to train in place of the recipe's own.

    Raises:
        ConfigError: no such recipe or policy, or a value that breaks a rule.
    """
    loaded = load_recipe(recipe or RECIPE_OF.get(policy or "", "default"))
    if policy is not None:
        loaded = _trains(loaded, policy)
    if generations is not None:
        loaded = recipe_from(loaded.model_dump() | {"generations": generations}, f"--generations {generations}")
    return Order(loaded, seed or 0, FIRST_HELD_OUT_TWIN if twin is None else twin, control)


def _trains(recipe: Recipe, policy: str) -> Recipe:
    """The recipe with another kind of policy."""
    from pipeline.policies.table import policy_kind

    if policy_kind(policy).sees and not recipe.dataset.cameras:
        raise ConfigError(f"policy {policy!r} sees, recipe {recipe.name!r} keeps no pictures",
                          where=f"--policy {policy}, dataset.cameras",
                          mend=f"use a recipe with a camera: --recipe {RECIPE_OF.get(policy, policy)}")
    return recipe.model_copy(update={"train": recipe.train.model_copy(update={"policy": policy})})


def recall(root: Path, run: str | None = None, policy: str | None = None) -> Order:
    """The order of a run that was begun in this store: of the newest one by default, or the newest with that policy.

    Raises:
        StoreError: there is no store, nothing was begun in it, or not this run; the known ones are listed.
    """
    with Store.open(root) as store:
        runs = store.runs()
        loops = {id: info for id, info in runs.items() if not info.control and policy in (None, _policy_of(info))}
        if run is None:
            invoked = [str(id) for (id,) in store.query("SELECT run FROM invocation ORDER BY rowid DESC")]
            run = next((id for id in invoked if id in loops), None)
        if run not in loops:
            what = f"no run {run}" if run else "no run was begun here"
            what += f" that trains {policy}" if policy else ""
            mend = f"use one of: {', '.join(loops)}" if loops else "begin one: hardcase loop"
            raise StoreError(what, where=root, mend=mend)
        info = loops[run]
    control = any(_same_numbers(info, other) for other in runs.values() if other.control)
    return Order(recipe_from(dict(info.recipe), f"run {run} of {root}"), info.seed, info.twin, control)


def _policy_of(info: RunInfo) -> str:
    """Kind of policy that a run trains."""
    return recipe_from(dict(info.recipe), "a run's recipe").train.policy


def _same_numbers(one: RunInfo, other: RunInfo) -> bool:
    return (one.recipe, one.seed, one.twin) == (other.recipe, other.seed, other.twin)


def open_order(order: Order, root: Path) -> AbstractContextManager[LoopSteps]:
    """Open the store under its lock and wire the stages to it; imported late, they bring MuJoCo and torch along.

    Raises:
        ConfigError: the recipe names a robot, scene or task that there is not; every valid name is listed.
        StoreError: another loop holds the store, or it cannot be used.
    """
    check_names(order.recipe)
    from flows.run.steps import open_run

    return open_run(root, order.recipe, seed=order.seed, twin=order.twin, control=order.control)


def refuse_legged(recipe: Recipe, what: str) -> None:
    """Return for a robot that learns from demonstrations.

    Raises:
        ConfigError: the recipe is of a legged robot.
    """
    if recipe.rl is not None:
        raise ConfigError(f"{what} is for robots that learn from demonstrations", where=f"recipe {recipe.name}: rl",
                          mend="what a legged policy learnt from: hardcase why POLICY; what hard starts are worth: "
                               "hardcase loop --control")


def check_names(recipe: Recipe) -> None:
    """Refuse names that are in no table, before anything is begun."""
    for kind, name, table in _tables(recipe):
        if name not in table:
            raise ConfigError(
                f"unknown {kind} {name!r}",
                where=f"recipe {recipe.name}, {kind}",
                mend=f"use one of: {', '.join(sorted(table))}",
            )


def _tables(recipe: Recipe) -> Sequence[tuple[str, str, Collection[str]]]:
    """Kind, name and valid names of what a recipe names; a recipe with `rl` is of a legged robot."""
    if recipe.rl is None:
        from pipeline.simulation.bodies import ROBOTS
        from pipeline.simulation.scenes import SCENES
        from pipeline.simulation.tasks import TASKS

        return ("robot", recipe.robot, ROBOTS), ("scene", recipe.scene, SCENES), ("task", recipe.task, TASKS)
    from pipeline.locomotion.bodies import LEGGED
    from pipeline.locomotion.scenes import SCENE
    from pipeline.locomotion.tasks import LEGGED_TASKS

    return (("robot", recipe.robot, LEGGED), ("scene", recipe.scene, (SCENE,)), ("task", recipe.task, LEGGED_TASKS),
            ("train.policy", recipe.train.policy, ("ppo",)))
