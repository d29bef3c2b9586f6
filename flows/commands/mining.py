"""The commands of mining: parse, call, print."""

import json as jsonlib
from pathlib import Path
from typing import Annotated

import typer

commands = typer.Typer()

Run = Annotated[str | None, typer.Option(help="Id of a run. [default: the newest]")]


@commands.command()
def mine(
    run: Run = None,
    generation: Annotated[int | None, typer.Option(min=0, help="Lap to look at. [default: the last deployed]")] = None,
    film: Annotated[bool, typer.Option(help="Render a film strip of every family's medoid.")] = True,
    json: Annotated[Path | None, typer.Option(help="Write families, cases and queue to this file as JSON.")] = None,
) -> None:
    """Tell a lap's failures apart by what happened, and say which corrections are worth most, and why.

    Example: hardcase mine --generation 0 --json mined.json
    """
    from flows.run.mining_told import as_json, mine_run, show
    from pipeline.files import atomic
    from pipeline.store import store_root

    told = mine_run(store_root(), run, generation, film=film)
    show(told)
    if json is not None:
        with atomic(json) as stream:
            stream.write(jsonlib.dumps(as_json(told), indent=1).encode() + b"\n")


@commands.command()
def regression(
    run: Run = None,
    play: Annotated[bool, typer.Option("--play", help="Play every scene 8 times in simulation.")] = False,
    policy: Annotated[str | None, typer.Option(help="Who plays: id of a policy. [default: the champion]")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """List the scenes that a release has fixed and that no later one may lose unsaid, by failure family.

    Example: hardcase regression --play
    """
    from flows.run.mining_told import regression_of, show_regression
    from pipeline.store import store_root

    scenes, solved = regression_of(store_root(), run, policy, play=play or policy is not None)
    if json:
        now = solved or [None] * len(scenes)
        typer.echo(jsonlib.dumps([{**s.model_dump(mode="json"), "solved_now": n}
                                  for s, n in zip(scenes, now, strict=True)]))
    else:
        show_regression(scenes, solved)
