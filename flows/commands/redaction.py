"""`hardcase redaction`: parse, call, print; cli_recordings.py adds it to `hardcase`."""

import json as jsonlib
from pathlib import Path
from typing import Annotated

import typer

redaction = typer.Typer(no_args_is_help=True)


@redaction.callback()
def about() -> None:
    """Look whether a redacted version is as it was signed.

    Example: hardcase redaction verify my-dataset
    """


@redaction.command()
def verify(
    name: Annotated[str, typer.Argument(metavar="VERSION|FOLDER", help="Redacted version, or an exported folder.")],
    key: Annotated[Path | None, typer.Option(help="Public key that it must be signed with.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """Verify signature and hashes of a redacted version; exit code 2 and one line if anything differs.

    Example: hardcase redaction verify my-dataset --key their.pub
    """
    from flows.data.redacting import verify as verified

    told = verified(name, key)
    typer.echo(jsonlib.dumps(told) if json else told["says"])
