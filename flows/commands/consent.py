"""`hardcase consent`: what people allowed to be done with recordings of them; parses, calls, prints."""

import json as jsonlib
from typing import Annotated

import typer

consent = typer.Typer(no_args_is_help=True)

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
Id = Annotated[str, typer.Argument(help="Id of a consent record.")]


@consent.callback()
def about() -> None:
    """Keep, list, show and revoke what people consented to; without it nobody's recording is learnt from.

    Example: hardcase consent list
    """


@consent.command()
def add(
    operator: Annotated[str, typer.Option(help="Pseudonym of the person; never a name.")],
    site: Annotated[str, typer.Option(help="Where the recordings are made.")],
    expires: Annotated[str, typer.Option(help="Last day on which it holds, YYYY-MM-DD.")],
    purpose: Annotated[list[str], typer.Option(help="training, evaluation or review; may be given again.")],
    given: Annotated[str | None, typer.Option(help="First day on which it holds. [default: today]")] = None,
    id: Annotated[str | None, typer.Option(help="Number of the form. [default: made from what it says]")] = None,
    json: AsJson = False,
) -> None:
    """Keep a person's consent; record with it: hardcase teleop --consent ID.

    Example: hardcase consent add --operator ada --site lab --purpose training --expires 2027-12-31
    """
    from flows.data.consents import add as add_record

    record = add_record(operator, site, tuple(purpose), given, expires, id)
    typer.echo(record.model_dump_json() if json else record.id)


@consent.command("list")
def every(json: AsJson = False) -> None:
    """List all records and whether they hold today.

    Example: hardcase consent list --json
    """
    from flows.data.consents import every, render

    records = every()
    typer.echo(jsonlib.dumps(records) if json else "\n".join(map(render, records)) or "no consent records yet")


@consent.command()
def show(id: Id, json: AsJson = False) -> None:
    """Show a record, and the episodes, versions and policies that rest on it.

    Example: hardcase consent show form-12
    """
    from flows.data.consents import one, render

    record = one(id)
    typer.echo(jsonlib.dumps(record) if json else render(record))


@consent.command()
def revoke(id: Id, json: AsJson = False) -> None:
    """Take a consent back, for good; its episodes stay stored and teach nothing any more.

    Example: hardcase consent revoke form-12
    """
    from flows.data.consents import render
    from flows.data.consents import revoke as revoke_record

    record = revoke_record(id)
    typer.echo(jsonlib.dumps(record) if json else render(record))
