"""Nights for people at a terminal: one lap without Prefect, and the ledger of all of them."""

from collections.abc import Sequence
from typing import Any

from flows.run.arm_run import run_id
from flows.run.arms import LOOP
from flows.run.opening import Order, open_order, order_of
from flows.service.estimate import night_steps
from pipeline.errors import ConfigError
from pipeline.store import Store, store_root
from schemas.night import Night


def run_night(*, recipe: str, seed: int, twin: int, day: int | None) -> list[dict[str, Any]]:
    """Turn the next lap of a lasting run; stages that were finished before are only looked up.

    Returns:
        stage, generation, ids, says, resumed of every step.

    Raises:
        ConfigError: the recipe has no nightly gate.
        HardcaseError: a stage refused.
    """
    order = nightly_order(recipe, seed, twin)
    told: list[dict[str, Any]] = []
    with open_order(order, store_root()) as steps:
        steps.day = day
        for step in night_steps(steps.tonight(), steps.recipe):
            done = getattr(steps, step.stage)(step.generation, lambda done, total: None)
            told.append({"stage": step.stage, "generation": step.generation, "ids": list(done.ids), "says": done.says,
                         "resumed": done.resumed})
    return told


def nightly_order(recipe: str, seed: int, twin: int) -> Order:
    """The order of a lasting run.

    Raises:
        ConfigError: no such recipe, or one without a nightly gate.
    """
    order = order_of(recipe, None, seed, twin)
    if order.recipe.gate.nightly is None:
        raise ConfigError("this recipe has no nightly gate", where=f"recipe {order.recipe.name}, gate.nightly",
                          mend="add `nightly: {}` below `gate:` in the recipe, or use --recipe nightly")
    return order


def ledger(*, recipe: str, seed: int, twin: int) -> list[Night]:
    """Every night of a lasting run, oldest first."""
    order = nightly_order(recipe, seed, twin)
    with Store.open(store_root()) as store:
        return store.nights(run_id(order.recipe, seed, twin, LOOP))


def ledger_table(rows: Sequence[Night]) -> str:
    """The ledger as text."""
    if not rows:
        return "no night was judged yet: hardcase night"
    lines = ["night   day  stake    left    promoted  since anchor  anchor"]
    for row in rows:
        met = ", roll back" if row.roll_back_to else " met" if row.anchor_verdict else ""
        lines.append(f"{row.generation:5d} {row.day:5d}  {row.candidates.stake:.5f}  {row.candidates.after:.5f} "
                     f" {'yes' if row.promoted else 'no':8s}  {row.promotions:12d}  {str(row.anchor)[:8]}{met}")
    return "\n".join(lines)
