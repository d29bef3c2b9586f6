"""The commands for recordings of people and of other robots: parse, call, print; cli.py adds them to `hardcase`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli_consent import consent
from flows.cli_teleop import teleop

commands = typer.Typer()

commands.add_typer(consent, name="consent")
commands.command()(teleop)


@commands.command()
def check(
    names: Annotated[list[str], typer.Argument(metavar="LOG|DATASET|ID...", help="MCAP files, dataset folders, ids.")],
    contract: Annotated[Path | None, typer.Option(help="YAML file that says what is expected.")] = None,
    init: Annotated[bool, typer.Option("--init", help="Print a contract that these good logs keep.")] = False,
    json: Annotated[Path | None, typer.Option(help="Write verdicts and findings to this file as JSON.")] = None,
) -> None:
    """Look for what is wrong with recordings and datasets; what fails is kept out of training.

    Exit code 0: all passed, 1: something is wrong, 2: something cannot be read.

    Example: hardcase check run.mcap --contract contract.yaml --json verdict.json
    """
    from flows.checking import check_all, write_contract

    if init:
        typer.echo(write_contract(names), nl=False)
        return
    text, code = check_all(names, contract=contract, out=json)
    typer.echo(text)
    raise typer.Exit(code)
