"""The commands for dataset versions: parse, call, print; cli_recordings.py adds them to `hardcase`."""

import json as jsonlib
from pathlib import Path
from typing import Annotated

import typer

datasets = typer.Typer()

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
Version = Annotated[str, typer.Argument(metavar="VERSION", help="Id of a dataset version, or its first 8 digits.")]
Where = Annotated[str | None, typer.Option(help='Query, such as "outcome == success and frames >= 40".')]
Limit = Annotated[int, typer.Option(min=0, help="Rows to print.")]


@datasets.command("datasets")
def versions(
    version: Annotated[str | None, typer.Argument(metavar="[VERSION]", help="Show the episodes of this one.")] = None,
    where: Where = None,
    limit: Limit = 50,
    json: AsJson = False,
) -> None:
    """List the dataset versions with size, sources, success and parents, or the episodes of one.

    Example: hardcase datasets 3f9ac812 --where "family == dropped"
    """
    from flows.data.version_table import episodes_of, render, render_episodes
    from flows.data.version_table import versions as every
    from pipeline.errors import ConfigError

    if version is None:
        if where is not None:
            raise ConfigError("a query chooses episodes, not versions", where=f"--where {where!r}",
                              mend='name a version, or ask the whole store: hardcase episodes --where "..."')
        rows = every()
        typer.echo(jsonlib.dumps(rows) if json else render(rows))
        return
    episodes = episodes_of(version, where)
    typer.echo(jsonlib.dumps(episodes) if json else render_episodes(episodes, limit))


@datasets.command()
def episodes(where: Where = None, limit: Limit = 50, json: AsJson = False) -> None:
    """List the episodes of the store that a query chooses, and count them.

    Example: hardcase episodes --where "source == deployed and outcome == failure"
    """
    from flows.data.version_table import catalog_episodes, render_episodes

    rows = catalog_episodes(where)
    typer.echo(jsonlib.dumps(rows) if json else render_episodes(rows, limit))


@datasets.command()
def derive(
    version: Version,
    add: Annotated[list[str] | None, typer.Option(
        help="VERSION whose episodes come in, or VERSION=SHARE of every batch; may be given again.")] = None,
    drop: Annotated[list[str] | None, typer.Option(help="Episode that leaves; may be given again.")] = None,
    keep_where: Annotated[str | None, typer.Option(help="Query: every other episode leaves.")] = None,
    trim: Annotated[list[str] | None, typer.Option(
        help="EPISODE:FIRST:AFTER_LAST, the frames that stay; may be given again.")] = None,
    relabel: Annotated[list[str] | None, typer.Option(
        help="EPISODE=success, failure or unknown; may be given again.")] = None,
    reweight: Annotated[list[str] | None, typer.Option(
        help="EPISODE=FACTOR or QUERY=FACTOR: drawn so many times as often; may be given again.")] = None,
    redact: Annotated[Path | None, typer.Option(
        help="YAML map of the fields, regions and cameras that are hidden, faces too; docs/redaction.md.")] = None,
    json: AsJson = False,
) -> None:
    """Derive a version from another; it shares with it what does not change, and only redacted videos are encoded.

    Example: hardcase derive 3f9ac812 --keep-where "outcome == success and family != slip" --trim 0fd4a1b2:10:80
    """
    from flows.data.deriving import Order, derive_version
    from flows.data.redacting import summary
    from schemas.edits import line

    order = Order(version, add or [], drop or [], keep_where, trim or [], relabel or [], reweight or [], redact)
    made = derive_version(order, progress=lambda told: None if json else typer.echo(f"  {told}", err=True))
    typer.echo(made.model_dump_json() if json else "\n".join(
        [f"{made.id}: {len(made.episodes)} episodes, {made.frames} frames, from {made.parent}",
         *(f"  {line(edit)}" for edit in made.edits), *([f"  {told}"] if (told := summary(made)) else [])]))


@datasets.command()
def diff(
    first: Annotated[str, typer.Argument(metavar="A", help="Id of a dataset version.")],
    second: Annotated[str, typer.Argument(metavar="B", help="Id of another.")],
    json: AsJson = False,
) -> None:
    """Name the episodes, rows and statistics that differ between two versions, and why.

    Example: hardcase diff 3f9ac812 77ab01ce
    """
    from flows.data.version_diff import compare, render

    told = compare(first, second)
    typer.echo(jsonlib.dumps(told) if json else render(told))


@datasets.command()
def export(
    version: Version,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where to; must not be there, or be empty.")],
    push_to: Annotated[str | None, typer.Option(
        help="Also upload to this USER/NAME on the Hugging Face Hub; private unless it is there already.")] = None,
    json: AsJson = False,
) -> None:
    """Copy a version into a plain folder that lerobot's own tools may change.

    Example: hardcase export 3f9ac812 my-dataset
    """
    from flows.data.exporting import export_version

    told = export_version(version, folder, push_to)
    typer.echo(jsonlib.dumps(told) if json else told["says"])


@datasets.command("import")
def bring_in(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A LeRobot v3 dataset.")],
    consent: Annotated[str | None, typer.Option(help="Consent record of whoever drove the robot.")] = None,
    weight: Annotated[float | None, typer.Option(
        help="Share of every batch that it gets when it is added to another version.")] = None,
    name: Annotated[str | None, typer.Option(help="What to call it. [default: the folder's name]")] = None,
    like: Annotated[str | None, typer.Option(help="Version whose robot, rate and features it must have.")] = None,
    json: AsJson = False,
) -> None:
    """Bring a LeRobot v3 dataset in as a version, after a check; the same folder twice adds nothing.

    Example: hardcase import ~/datasets/my-arm --consent form-12 --weight 0.3 --name my-arm
    """
    from flows.data.importing import ImportOrder, import_folder, render

    told = import_folder(ImportOrder(folder, consent, weight, name, like))
    typer.echo(jsonlib.dumps(told) if json else render(told))
