"""The command line: parses, calls, prints, sets the exit code. Heavy imports wait inside the commands."""

import json as jsonlib
import os
import sys
from pathlib import Path
from typing import Annotated

import typer
import typer.main
from typer.exceptions import TyperException

from flows.commands.recordings import commands as recordings
from flows.commands.stages import VERBS, AsJson, Policy, Recipe, Seed, Twin
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

Control = Annotated[bool, typer.Option("--control", help="Also turn the loop with random starts, for comparison.")]


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


for verb in VERBS:
    app.command()(verb)


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
