"""The command line: parses, calls, prints, sets the exit code. Heavy imports wait inside the commands."""

import json as jsonlib
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.main
from typer.exceptions import TyperException

from flows.commands.recordings import commands as recordings
from flows.commands.wrong_words import PROGRAM, refusal, with_help
from pipeline.errors import ConfigError, HardcaseError

REFUSED, INTERRUPTED = 2, 130

app = typer.Typer(
    name="hardcase",
    help="Turn a robot's failures into its next training data.\n\nExample: hardcase loop --generations 3",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

app.add_typer(recordings)  # without a name: its commands stand beside the others

Recipe = Annotated[str | None, typer.Option(help="Recipe: a name in datasets/recipes, or a path. [default: default]")]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed of data and training. [default: 0]")]
Twin = Annotated[int | None, typer.Option(min=0, help="Seed of the simulated real robot. [default: 100]")]
Policy = Annotated[str | None, typer.Option(help="Kind of policy to train: chunked, or act. [default: the recipe's]")]
Control = Annotated[bool, typer.Option("--control", help="Also turn the loop with random starts, for comparison.")]
Run = Annotated[str | None, typer.Option(help="Id of a run that was begun before. [default: the newest]")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]


def main() -> None:
    """Run the command line; every refusal is what / at / mend on stderr and exit code 2, without a traceback."""
    words, root = sys.argv[1:], typer.main.get_command(app)
    try:
        sys.exit(root.main(with_help(root, words), prog_name=PROGRAM, standalone_mode=False))
    except TyperException as error:
        _refuse(refusal(root, words, error))
    except HardcaseError as error:
        _refuse(error)
    except KeyboardInterrupt:
        _say("stopped")
        sys.exit(INTERRUPTED)
    except Exception as error:
        if os.environ.get("HARDCASE_DEBUG"):
            raise
        _refuse(_unexpected(error))


def _refuse(error: HardcaseError) -> None:
    color = sys.stderr.isatty() and not os.environ.get("NO_COLOR")
    _say(typer.style(str(error), fg="red") if color else str(error))
    sys.exit(REFUSED)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _unexpected(error: Exception) -> HardcaseError:
    """A fault of ours in the shape of every other error: where it came from, and how to see more."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}" if trace else "unknown"
    lines = str(error).strip().splitlines()
    what = f"{type(error).__name__}: {lines[0] if lines else 'no message'}"
    mend = "this is a fault in Hardcase: set HARDCASE_DEBUG=1 for the whole story; a loop goes on with --resume"
    return HardcaseError(what, where=where, mend=mend)


@app.command()
def loop(
    generations: Annotated[int | None, typer.Option(min=0, help="Laps after generation 0. [default: 3]")] = None,
    seed: Seed = None,
    twin: Twin = None,
    recipe: Recipe = None,
    policy: Policy = None,
    control: Control = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the newest run of this store.")] = False,
    json: Annotated[Path | None, typer.Option(help="Write the result to this file as JSON.")] = None,
    browse: Annotated[bool, typer.Option(help="Open the report if there is a display.")] = True,
) -> None:
    """Turn the whole loop: collect, augment, build, train, gate, release, deploy, harvest, begin again.

    Stages that the store already holds for this recipe, seed and twin are kept.

    Example: hardcase loop --generations 3 --twin 101 --json result.json
    """
    from flows.run.opening import order_of, recall
    from pipeline.store import store_root

    if resume and (control or any(option is not None for option in (generations, seed, twin, recipe, policy))):
        raise ConfigError(
            "--resume goes on with the newest run as it was ordered",
            where="hardcase loop",
            mend="leave the other options away; or leave --resume away: the same options find the same run",
        )
    order = recall(store_root()) if resume else order_of(
        recipe, generations, seed, twin, control=control, policy=policy)

    from flows.service.session import run_loop

    try:
        run_loop(order, store_root(), json=json, browse=browse)
    except KeyboardInterrupt:
        _say("stopped; finished stages are kept, go on with: hardcase loop --resume")
        raise typer.Exit(INTERRUPTED) from None


def _stage(
    name: str, run: str | None, recipe: str | None, seed: int | None, twin: int | None, *, as_json: bool,
    policy: str | None = None,
) -> None:
    """Run one stage of the current generation by hand: the same steps as the flow's, without Prefect."""
    from flows.commands.by_hand import run_stage

    _print(run_stage(name, run=run, recipe=recipe, seed=seed, twin=twin, policy=policy), as_json)


def _print(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        typer.echo(jsonlib.dumps(result))
    else:
        kept = " (kept)" if result["resumed"] else ""
        typer.echo(f"generation {result['generation']} {result['stage']}: {result['says']}{kept}")
        for id in result["ids"][:5]:
            typer.echo(f"  {id}")
        if len(result["ids"]) > 5:
            typer.echo(f"  and {len(result['ids']) - 5} more (--json lists them)")


@app.command()
def collect(run: Run = None, recipe: Recipe = None, policy: Policy = None, seed: Seed = None, twin: Twin = None,
            json: AsJson = False) -> None:
    """Record scripted demonstrations; begins a new run when a recipe, policy, seed or twin is given.

    Example: hardcase collect --recipe smoke --seed 1
    """
    _stage("collect", run, recipe, seed, twin, as_json=json, policy=policy)


@app.command()
def augment(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
            json: AsJson = False) -> None:
    """Make variants of what is new and keep those that succeed.

    Example: hardcase augment
    """
    _stage("augment", run, recipe, seed, twin, as_json=json)


@app.command()
def build(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
          json: AsJson = False) -> None:
    """Build the dataset version of this generation, a LeRobot v3 folder.

    Example: hardcase build --json
    """
    _stage("build", run, recipe, seed, twin, as_json=json)


@app.command()
def train(run: Run = None, recipe: Recipe = None, policy: Policy = None, seed: Seed = None, twin: Twin = None,
          json: AsJson = False) -> None:
    """Train the candidate and export it to ONNX; with --policy, that of the newest run which trains this kind.

    Example: hardcase train --policy act
    """
    _stage("train", run, recipe, seed, twin, as_json=json, policy=policy)


@app.command()
def gate(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
         json: AsJson = False) -> None:
    """Test the candidate against the champion on the same scenes.

    Example: hardcase gate --json
    """
    _stage("gate", run, recipe, seed, twin, as_json=json)


@app.command()
def release(
    run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
    rollback: Annotated[bool, typer.Option("--rollback", help="Go back to the champion before this one.")] = False,
    json: AsJson = False,
) -> None:
    """Move the champion pointer if the gate says so.

    Example: hardcase release --rollback
    """
    if rollback:
        from flows.commands.by_hand import roll_back

        _print(roll_back(run=run), json)
    else:
        _stage("release", run, recipe, seed, twin, as_json=json)


@app.command()
def deploy(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
           json: AsJson = False) -> None:
    """Let the champion work on the twin and record every attempt.

    Example: hardcase deploy
    """
    _stage("deploy", run, recipe, seed, twin, as_json=json)


@app.command()
def harvest(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
            json: AsJson = False) -> None:
    """Find the hard cases of the last deployment and have them corrected.

    Example: hardcase harvest --json
    """
    _stage("harvest", run, recipe, seed, twin, as_json=json)


@app.command()
def exam(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
         json: AsJson = False) -> None:
    """Examine the champion on the twin starts that no decision reads.

    Example: hardcase exam
    """
    _stage("exam", run, recipe, seed, twin, as_json=json)


@app.command()
def report(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
           json: AsJson = False) -> None:
    """Write the HTML report of a run and print its path.

    Example: hardcase report
    """
    _stage("report", run, recipe, seed, twin, as_json=json)


@app.command()
def study(
    seeds: Annotated[int, typer.Option(min=1, help="Seeds: twin, data and training together.")] = 8,
    recipe: Recipe = None,
    arm: Annotated[list[str] | None, typer.Option(
        help="A control arm to run, or loop for none; may be given again.")] = None,
    first: Annotated[int, typer.Option(min=0, help="Number of the first seed; seed k has twin 100 + k.")] = 0,
    json: Annotated[Path | None, typer.Option(help="Write every arm and seed to this file as JSON.")] = None,
) -> None:
    """Run the loop beside its controls and print what each arm reaches. Takes hours.

    Example: hardcase study --seeds 8 --json study.json
    """
    from flows.studies.study import run_study

    run_study(seeds=seeds, recipe=recipe or "default", json=json, arms=tuple(arm or ()), first=first)


@app.command()
def doctor(json: AsJson = False) -> None:
    """Check this machine: rendering, disk, cores, versions, store; each with its mend.

    Example: hardcase doctor --json
    """
    from flows.doctor import examine, render

    checks = examine()
    typer.echo(jsonlib.dumps([check.as_dict() for check in checks]) if json else render(checks))
    raise typer.Exit(0 if all(check.ok or not check.needed for check in checks) else 1)


@app.command()
def gc(
    delete: Annotated[bool, typer.Option("--delete", help="Really remove; without it nothing is touched.")] = False,
    json: AsJson = False,
) -> None:
    """List what nothing in the store refers to any more, and lerobot's own caches; dry run first.

    Example: hardcase gc --delete
    """
    from flows.data.upkeep import sweep

    typer.echo(sweep(delete=delete, as_json=json))


@app.command()
def recover(
    folder: Annotated[Path | None, typer.Argument(help="Folder to look through. [default: the store]")] = None,
    json: AsJson = False,
) -> None:
    """Save what is whole of recordings that were cut off.

    Example: hardcase recover recordings
    """
    from flows.data.upkeep import recover_recordings

    typer.echo(recover_recordings(folder, as_json=json))


if __name__ == "__main__":
    main()
