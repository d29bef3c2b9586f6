"""The commands for recordings of people and of other robots: parse, call, print; cli.py adds them to `hardcase`."""

import typer

from flows.cli_consent import consent

commands = typer.Typer()

commands.add_typer(consent, name="consent")
