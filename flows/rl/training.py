"""`hardcase rl`: trainings of legged robots by PPO, and their evaluation beside the baselines."""

import json as jsonlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from flows.studies.measured import write_json
from pipeline.errors import ConfigError, PolicyError
from pipeline.ppo.config import Order
from pipeline.store import store_root

POLICY, REPORT = "policy.onnx", "training.json"
"""What a finished training leaves in its folder beside the last checkpoint."""
BASELINES = ("zero action", "random action")


def folder_of(order: Order) -> Path:
    """Where a training lies unless another folder is given."""
    return store_root() / "rl" / f"{Path(order.body).stem}-{order.name}-{order.seed}"


def run_train(order: Order, folder: Path, *, threads: int, resume: bool, as_json: bool,
              weights: Path | None = None) -> str:
    """Train to the end, export, and say what to print.

    Raises:
        HardcaseError: a wrong name, a folder of another training, or one that would be overwritten.
    """
    from pipeline.policies.resuming import newest

    if newest(folder) is not None and not resume:
        raise ConfigError("a training lies here already", where=folder,
                          mend="go on with --resume, or give another folder with --out")
    found = trained(order, folder, threads=threads, weights=weights)
    if as_json:
        return jsonlib.dumps({key: value for key, value in found.items() if key != "curve"})
    last = found["curve"][-1]
    terms = ", ".join(f"{name} {value:.3f}" for name, value in last["terms"].items())
    return (f"{order.body} {order.name}, seed {order.seed}: {found['steps']} steps in {found['cpu_s']:.0f} CPU s, "
            f"{found['wall_s']:.0f} s\nreward a tick: {last['reward']:.3f} = {terms}\n{folder / POLICY}\n"
            f"next: hardcase rl evaluate {folder}")


def trained(order: Order, folder: Path, *, threads: int = 1, weights: Path | None = None) -> dict[str, Any]:
    """A training from where it stands to its end: its facts and curves, which it leaves as training.json.

    Args:
        order: what is trained.
        folder: where all of it lies.
        threads: threads of the engine.
        weights: file that the order goes on from.
    """
    from pipeline.ppo.training import Training

    folder.mkdir(parents=True, exist_ok=True)
    training = Training(order, folder, threads=threads, weights=weights)
    with _bar() as bar:
        task = bar.add_task("train", total=order.ppo.steps, completed=training.steps, says="")

        def told(point: Any, total: int) -> None:
            says = "" if point["length"] is None else f"{point['length']:.0f} ticks, {point['reward']:.2f} a tick"
            bar.update(task, completed=point["step"], says=says)

        training.run(told)
    apart = training.export(folder / POLICY)
    found: dict[str, Any] = {
        "order": order.model_dump(mode="json"), "id": order.id, "steps": training.steps, "onnx_apart": apart,
        "cpu_s": training.cpu_s, "wall_s": training.wall_s, "curve": training.curve}
    write_json(folder / REPORT, found)
    return found


def run_evaluate(policy: Path, *, attempts: int, seed: int, stratum: str | None, threads: int, as_json: bool,
                 speed: float | None = None, json: Path | None = None) -> str:
    """Evaluate a policy beside zero and random actions on the same starts, and say what to print."""
    found = evaluated(policy, attempts=attempts, seed=seed, stratum=stratum, threads=threads, speed=speed)
    write_json(json, found)
    if as_json:
        return jsonlib.dumps(found)
    table = Table("who acts", "full attempts", "full at that speed", "mean length [s]", "off the asked speed [m/s]",
                  "reward terms a tick")
    for name, arm in found["arms"].items():
        table.add_row(name, *(f"{share['rate']:.3f} [{share['low']:.3f} {share['high']:.3f}]"
                              for share in (arm, arm["follows"])), f"{arm['length_s']:.1f}",
                      f"{arm['error']:.2f}", ", ".join(f"{k} {v:.2f}" for k, v in arm["terms"].items()))
    console = Console(width=150)
    with console.capture() as said:
        console.print(f"{found['body']} {found['task']}: {attempts} attempts at {found['stratum']} starts, seed {seed}"
                      + ("" if speed is None else f", {speed:g} m/s asked"))
        console.print(table)
    return said.get().rstrip()


def evaluated(policy: Path, *, attempts: int, seed: int, stratum: str | None = None, threads: int = 1,
              speed: float | None = None, outcomes: Callable[[str, Any], None] | None = None) -> dict[str, Any]:
    """The policy, zero action and random actions on the same starts, each with a Wilson interval.

    Args:
        policy: an ONNX file, or the folder of a training.
        attempts: how many starts.
        seed: of the starts, which no training meets.
        stratum: kind of start; that of the training where None.
        threads: threads of the engine.
        speed: forward, asked for in every attempt [m/s]; as the task draws it where None.
        outcomes: called with each arm's name and its Evaluated.

    Raises:
        HardcaseError: no such policy, one that is for another robot, or a speed that it never learned.
    """
    from pipeline.locomotion.bodies import load_legged
    from pipeline.locomotion.evaluation import evaluate, random_action, zero_action

    runner, body_name, task = opened(policy, speed)
    body = load_legged(body_name)
    kind = stratum or runner.facts.get("stratum") or next(iter(task.starts))
    arms: dict[str, Any] = {}
    for name, act in {"policy": runner, BASELINES[0]: zero_action(len(body.joints)),
                      BASELINES[1]: random_action(len(body.joints), seed)}.items():
        done = evaluate(act, body, task, n=attempts, seed=seed, stratum=kind, threads=threads)
        if outcomes is not None:
            outcomes(name, done)
        arms[name] = _told(done, task.control_hz)
    return {"policy": str(_file(policy)), "training": runner.facts.get("training"), "body": body_name,
            "task": runner.facts["name"], "stratum": kind, "attempts": attempts, "seed": seed, "speed": speed,
            "arms": arms}


def _told(done: Any, control_hz: float) -> dict[str, Any]:
    """One arm in numbers."""
    from pipeline.statistics import wilson

    full, follows = (int(bits.sum()) for bits in (done.full, done.follows))
    share, following = wilson(full, len(done.full)), wilson(follows, len(done.full))
    mean = done.mean[done.full]
    return {"full": full, "rate": share.rate, "low": share.low, "high": share.high,
            "follows": {"rate": following.rate, "low": following.low, "high": following.high},
            "length_s": float(done.length.mean()) / control_hz, "error": done.error, "terms": done.terms,
            "speed_of_full_m_s": float(mean[:, 0].mean()) if full else None,
            "off_of_full_m_s": float(abs(mean - done.asked[done.full])[:, 0].mean()) if full else None,
            "steps_hz": float(done.steps_hz[done.full].mean()) if full else None,
            "airborne": float(done.airborne[done.full].mean()) if full else None}


def _file(policy: Path) -> Path:
    return policy / POLICY if policy.is_dir() else policy


def opened(policy: Path, speed: float | None = None) -> tuple[Any, str, Any]:
    """A policy, and the body and task that its file says it is for.

    Args:
        policy: an ONNX file, or the folder of a training.
        speed: forward, that the task shall ask for in every attempt [m/s]; as it draws it where None.

    Raises:
        HardcaseError: no policy of a legged robot, or a speed that it never learned.
    """
    from pipeline.ppo.runner import OnnxRunner

    file = _file(policy)
    if policy.is_dir() and not file.exists():
        raise PolicyError("no policy here yet", where=policy, mend="finish the training: hardcase rl train --resume")
    runner = OnnxRunner(file)
    body, task = _meant(runner, file)
    if speed is None:
        return runner, body, task
    low, high = task.command[0]
    if not low <= speed <= high:
        raise ConfigError(f"speed {speed:g} m/s, which this policy never learned", where=file,
                          mend=f"ask for {low:g} to {high:g} m/s" if low < high else
                          "evaluate without --speed, or train one that walks: hardcase rl train --task walk")
    return runner, body, task.asking(speed)


def _meant(runner: Any, file: Path) -> tuple[str, Any]:
    """Body and task that a policy's file says it is for."""
    from pipeline.locomotion.tasks import LeggedTask

    try:
        return runner.facts["body"], LeggedTask.model_validate_json(runner.facts["task"])
    except (KeyError, ValueError) as error:
        raise PolicyError("the file does not say which body and task it is for", where=file,
                          mend="use a policy.onnx that hardcase rl train has left") from error


def _bar() -> Progress:
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24),
               TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"), TimeRemainingColumn(),
               TextColumn("{task.fields[says]}"))
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
