"""The commands for recordings of people and of other robots: parse, call, print; cli.py adds them to `hardcase`."""

import typer

commands = typer.Typer()
