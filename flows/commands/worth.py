"""`hardcase worth`: parse, call; cli_recordings.py adds it to `hardcase`."""

from typing import Annotated

import typer


def worth(
    batch: Annotated[str | None, typer.Argument(
        metavar="[BATCH]", help="Dataset version, or number of a lap of the newest run: what it added to the version "
                                "before. The last that added something where it is not given.")] = None,
    where: Annotated[str | None, typer.Option(help="Judge these episodes of the version: a query.")] = None,
    episode: Annotated[list[str] | None, typer.Option(help="Judge this one; may be given again.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Trainings with and as many without; fewer than 8 decide "
                                                   "nothing.")] = 8,
    scenes: Annotated[int, typer.Option(min=20, help="Simulated scenes that each policy plays.")] = 200,
    every: Annotated[bool, typer.Option("--list", help="Judge nothing; list the last verdict on every batch.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """Say what a batch of episodes is worth: policies retrained with it and without it, on the same scenes.

    HELPS, HURTS or INCONCLUSIVE. What hurts is left out of later versions. What was cut off goes on where it was.

    Exit code 0, or 1 where the batch hurts.

    Example: hardcase worth 3f9a1c2b --where "source == corrected" --seeds 8
    """
    from flows.run.worth import list_worths, run_worth
    from flows.run.worth_batch import Order

    if every:
        typer.echo(list_worths(as_json=json))
        return
    text, code = run_worth(Order(batch, where, tuple(episode or ()), seeds, scenes), as_json=json)
    typer.echo(text)
    raise typer.Exit(code)
