"""`hardcase selftest`: whether the checks find what they are made for; parses, calls, prints."""

from pathlib import Path
from typing import Annotated

import typer


def selftest(
    json: Annotated[Path | None, typer.Option(help="Write the result to this file as JSON.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Other episodes, and faults in other places and sizes.")] = 0,
    referees: Annotated[bool, typer.Option("--referees", help="Ask checkers that others wrote, too.")] = False,
    keep: Annotated[Path | None, typer.Option(help="New folder in which clean and spoiled files stay.")] = None,
) -> None:
    """Plant known faults in recordings and datasets, and show which check catches each; 100 clean episodes must pass.

    Exit code 0: all faults were caught and nothing clean was accused, 1: not so.

    Example: hardcase selftest --json selftest.json
    """
    from flows.selftest.catching import run_selftest

    text, code = run_selftest(seed=seed, out=json, keep=keep, referees=referees)
    typer.echo(text)
    raise typer.Exit(code)
