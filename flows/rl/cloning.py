"""`hardcase rl clone`: an expert plays, PPO's networks learn what it did, and a training may go on from there."""

import json as jsonlib
from pathlib import Path
from typing import Any

from flows.rl.training import POLICY, opened
from flows.rl.warm import WEIGHTS
from flows.studies.measured import write_json
from pipeline.errors import ConfigError
from pipeline.ppo.config import Order
from pipeline.store import store_root

BALANCE = "balance"
"""The expert that is written by hand."""
REPORT = "clone.json"
MOST_PLAYED = 20
"""An expert plays at most this many times the attempts that are wanted."""


def folder_of(order: Order, expert: str) -> Path:
    """Where a clone lies unless another folder is given."""
    return store_root() / "rl" / f"clone-{Path(expert).stem}-{Path(order.body).stem}-{order.name}-{order.seed}"


def run_clone(order: Order, expert: str, folder: Path, *, attempts: int, calm: bool, as_json: bool) -> str:
    """Clone, and say what to print."""
    if (folder / REPORT).exists():
        raise ConfigError("a clone lies here already", where=folder, mend="give another folder with --out")
    found = cloned(order, expert, folder, attempts=attempts, calm=calm)
    if as_json:
        return jsonlib.dumps(found)
    last, shown = found["epochs"][-1], found["demonstrations"]
    off = last["actor"] if last["held_out"] is None else last["held_out"]
    return (f"{expert}: {shown['kept']} of {shown['played']} attempts reached their end, {shown['steps']} steps\n"
            f"cloned to a mean squared error of {off:.5f} (shares of an action)\n{folder / POLICY}\n"
            f"next: hardcase rl train --task {order.name} --body {order.body} --warm {folder}")


def cloned(order: Order, expert: str, folder: Path, *, attempts: int, calm: bool = False) -> dict[str, Any]:
    """Demonstrations and a clone of them: weights to go on from, an ONNX policy, and how it went as clone.json.

    Args:
        order: of the training that may follow; its task, kind of start, network and seed are the clone's.
        expert: "balance", or a policy: an ONNX file or the folder of a training.
        folder: where all of it goes.
        attempts: full attempts that are wanted of the expert.
        calm: whether no blows come while it demonstrates.

    Raises:
        HardcaseError: no such expert, one of another robot, or one that falls always.
    """
    from pipeline.locomotion.bodies import load_legged
    from pipeline.locomotion.demonstrations import demonstrate
    from pipeline.locomotion.tasks import Pushes
    from pipeline.ppo.cloning import CloneConfig, clone
    from pipeline.ppo.training import Training

    body = load_legged(order.body)
    act = _expert(expert, order)
    task = order.task.model_copy(update={"pushes": Pushes()}) if calm else order.task
    stratum = order.stratum or next(iter(order.task.starts))
    shown = demonstrate(act, body, task, keep=attempts, most=MOST_PLAYED * attempts, seed=order.seed, stratum=stratum,
                        gamma=order.ppo.gamma)
    folder.mkdir(parents=True, exist_ok=True)
    training, config = Training(order, folder), CloneConfig()
    epochs = clone(training, shown, config, seed=order.seed)
    weights = training.leave_weights(folder / WEIGHTS)
    training.order = order.model_copy(update={"goes_on": weights})  # the policy is what that training begins with
    found: dict[str, Any] = {
        "expert": expert, "order": order.model_dump(mode="json"), "calm": calm, "config": config.model_dump(),
        "demonstrations": {"stratum": stratum, "kept": len(shown.sensed), "played": shown.played,
                           "steps": shown.steps},
        "epochs": [epoch.model_dump() for epoch in epochs], "weights": weights,
        "onnx_apart": training.export(folder / POLICY)}
    write_json(folder / REPORT, found)
    return found


def _expert(name: str, order: Order) -> Any:
    """Who demonstrates; PolicyError or ConfigError where it cannot act for this robot."""
    from pipeline.locomotion.balance import BalanceController
    from pipeline.locomotion.bodies import load_legged

    if name == BALANCE:
        return BalanceController(load_legged(order.body))
    runner, body, _ = opened(Path(name))
    if body != order.body:
        raise ConfigError(f"the expert is a {body}, to be taught is a {order.body}", where=name,
                          mend=f"teach that body: --body {body}")
    return runner
