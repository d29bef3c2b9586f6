"""`hardcase rl`: parse, call, print; cli_recordings.py adds it to `hardcase`."""

from pathlib import Path
from typing import Annotated

import typer

rl = typer.Typer(no_args_is_help=True)

Threads = Annotated[int, typer.Option(min=1, max=64, help="Threads of the engine; results do not depend on them.")]


@rl.callback()
def about() -> None:
    """Legged robots and PPO: train, and evaluate beside zero and random actions.

    Example: hardcase rl train --body biped --task stand
    """


@rl.command()
def train(
    body: Annotated[str, typer.Option(help="biped, unitree_h1, unitree_g1, or the path of an MJCF or URDF.")] = "biped",
    task: Annotated[str, typer.Option(help="stand, walk, or the path of a YAML file.")] = "stand",
    seed: Annotated[int, typer.Option(min=0, help="Of starts, weights and draws.")] = 0,
    stratum: Annotated[str | None, typer.Option(help="Kind of start. [default: the task's first]")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Environment steps. [default: the task's]")] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Of Adam at the start. [default: the task's]")] = None,
    attempts: Annotated[int | None, typer.Option(min=1, help="Attempts side by side. [default: the task's]")] = None,
    warm: Annotated[Path | None, typer.Option(help="Go on from a clone or a training: its folder. [default: random]")]
    = None,
    threads: Threads = 1,
    out: Annotated[Path | None, typer.Option(help="Folder. [default: rl/BODY-TASK-SEED in the store]")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint, to the same bits.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """Train a legged robot by PPO; leaves checkpoints, policy.onnx, and training.json with every curve.

    Example: hardcase rl train --body biped --task stand --seed 0
    """
    from flows.rl.order import order_of
    from flows.rl.training import folder_of, run_train
    from flows.rl.warm import weights_of

    weights, goes_on = (None, None) if warm is None else weights_of(warm)
    order = order_of(body, task, seed, stratum=stratum, goes_on=goes_on,
                     given={"steps": steps, "learning_rate": learning_rate, "attempts": attempts})
    typer.echo(run_train(order, out or folder_of(order), threads=threads, resume=resume, as_json=json, weights=weights))


@rl.command()
def clone(
    expert: Annotated[str, typer.Argument(help="balance (written by hand), a policy.onnx, or a training's folder.")]
    = "balance",
    body: Annotated[str, typer.Option(help="biped, unitree_h1, unitree_g1, or the path of an MJCF or URDF.")] = "biped",
    task: Annotated[str, typer.Option(help="stand, walk, or the path of a YAML file.")] = "stand",
    seed: Annotated[int, typer.Option(min=0, help="Of demonstrations, weights and batches.")] = 0,
    stratum: Annotated[str | None, typer.Option(help="Kind of start. [default: the task's first]")] = None,
    attempts: Annotated[int, typer.Option(min=1, help="Attempts of the expert that must reach their end.")] = 100,
    calm: Annotated[bool, typer.Option("--calm", help="No blows come while the expert demonstrates.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder. [default: rl/clone-EXPERT-BODY-TASK-SEED]")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """Clone an expert's attempts into PPO's networks; `rl train --warm` goes on from there.

    Example: hardcase rl clone balance --calm --attempts 100
    """
    from flows.rl.cloning import folder_of, run_clone
    from flows.rl.order import order_of

    order = order_of(body, task, seed, stratum=stratum)
    typer.echo(run_clone(order, expert, out or folder_of(order, expert), attempts=attempts, calm=calm, as_json=json))


@rl.command()
def report(
    runs: Annotated[list[Path], typer.Argument(help="Folders of trainings; seeds of one order are drawn together.")],
    out: Annotated[Path | None, typer.Option(help="The page. [default: reports/rl-ID.html in the store]")] = None,
    attempts: Annotated[int, typer.Option(min=0, help="Starts of an evaluation; 0 for none.")] = 300,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts, which no training meets.")] = 0,
    stratum: Annotated[list[str] | None, typer.Option(
        help="Kind of start that is judged; may be given again. [default: the training's and the first]")] = None,
    threads: Threads = 1,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """Write a page of trainings: success, each reward term, PPO's own figures, evaluation, orders and hashes.

    What is not evaluated yet is evaluated now, and kept beside the training.

    Example: hardcase rl report datasets/store/rl/biped-stand-0 datasets/store/rl/biped-stand-1 --out stand.html
    """
    from flows.rl.reporting import run_report

    typer.echo(run_report(runs, out, attempts=attempts, seed=seed, strata=tuple(stratum or ()), threads=threads,
                          as_json=json))


@rl.command()
def evaluate(
    policy: Annotated[Path, typer.Argument(help="policy.onnx, or the folder of a training.")],
    attempts: Annotated[int, typer.Option(min=1, help="Starts, each played once to its end.")] = 300,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts, which no training meets.")] = 0,
    stratum: Annotated[str | None, typer.Option(help="Kind of start. [default: the training's]")] = None,
    speed: Annotated[float | None, typer.Option(help="Forward, asked for [m/s]. [default: as the task draws]")] = None,
    strip: Annotated[Path | None, typer.Option(help="Draw the first attempt into this .webp or .png, too.")] = None,
    threads: Threads = 1,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """Evaluate a policy beside zero and random actions, on the same starts; with a film strip of one attempt.

    Example: hardcase rl evaluate datasets/store/rl/biped-walk-0 --speed 0.5 --strip walk.webp
    """
    from flows.rl.training import run_evaluate

    drawn = None
    if strip is not None:
        from flows.rl.strip import write_strip

        drawn = write_strip(policy, strip, seed=seed, stratum=stratum, speed=speed)
    typer.echo(run_evaluate(policy, attempts=attempts, seed=seed, stratum=stratum, threads=threads, speed=speed,
                            as_json=json))
    if drawn is not None:
        typer.echo(drawn, err=json)
