"""`hardcase why` and `hardcase forget`: parse, call, print; cli_recordings.py adds them to `hardcase`."""

import json as jsonlib
import sys
from pathlib import Path
from typing import Annotated

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]


def why(
    id: Annotated[str, typer.Argument(help="Policy, dataset version, episode, hard case, verdict, consent, log, "
                                           "conversion, check or run; 8 digits are enough.")],
    forward: Annotated[bool, typer.Option("--forward", help="Only what used it.")] = False,
    json: AsJson = False,
    svg: Annotated[Path | None, typer.Option(help="Draw both directions into this file.", metavar="OUT.svg")] = None,
) -> None:
    """Print the chain from anything back to recordings, draws, seeds, code and config, and forward to what used it.

    Example: hardcase why 3f9a1c2b --svg why.svg
    """
    from flows.data.lineages import explain

    typer.echo(explain(id, forward=forward, as_json=json, svg=svg))


def forget(
    episode: Annotated[str, typer.Argument(help="Id of an episode; 8 digits are enough.")],
    reason: Annotated[str | None, typer.Option(help="Why; it is kept, so it names nobody.")] = None,
    with_log: Annotated[bool, typer.Option("--with-log", help="Also lose the raw log that it lies in.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do it without asking.")] = False,
    json: AsJson = False,
) -> None:
    """Erase an episode and everything that holds it: recordings, rows of versions, variants, reports, caches.

    First it says what would go. What was cut off is finished by calling it again.

    Example: hardcase forget 3f9a1c2b --reason "asked by the person"
    """
    from flows.data.forgetting import carried_out, planned, render, render_done

    plan, begun = planned(episode, reason, with_log=with_log)
    asks = not yes and not json and sys.stdin.isatty()
    if not json:
        typer.echo(render(plan) + ("\n  it was begun before and cut off; it can only be finished" if begun else ""))
    if not (yes or (asks and typer.confirm("This cannot be undone. Erase?"))):
        typer.echo(plan.model_dump_json() if json else "nothing was touched; to erase it, add: --yes")
        return
    done = carried_out(plan, lambda step: None if json else typer.echo(f"  {step}"))
    typer.echo(jsonlib.dumps(done) if json else render_done(done, plan))
