"""hardcase ingest on the command line."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.errors import ConfigError

if TYPE_CHECKING:
    from schemas.recipe import CameraConfig


def ingest(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="MCAP files, or folders of them.")],
    map: Annotated[Path | None, typer.Option(help="YAML file: which topics and fields become which features.")] = None,
    dataset: Annotated[str | None, typer.Option(help="Build a version of this name from the episodes.")] = None,
    camera: Annotated[list[str] | None, typer.Option(
        metavar="NAME=WxH", help="Size of a camera's videos in the version; its own where none is given.")] = None,
    suggest: Annotated[bool, typer.Option("--suggest", help="Print a first map for a log and stop.")] = False,
    out: Annotated[Path | None, typer.Option(help="Write what --suggest prints to this file, a new one.")] = None,
    accept_truncated: Annotated[bool, typer.Option(
        "--accept-truncated", help="Keep what comes before the first damage or missing byte.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """Bring other robots' logs into the store and convert them by a declared map; only what changed is done again.

    The raw file is kept untouched. Exit code 0: all converted, 2: a log was refused or quarantined.

    Example: hardcase ingest --suggest run.mcap > map.yaml; hardcase ingest *.mcap --map map.yaml --dataset first
    """
    from flows.data.ingest_display import ingest_all, suggest_map

    if suggest:
        typer.echo(suggest_map(logs, out), nl=False)
        return
    if map is None:
        raise ConfigError("no map says how to read the logs", where="hardcase ingest",
                          mend=f"write one, or begin with: hardcase ingest --suggest {logs[0]} > map.yaml")
    text, code = ingest_all(logs, map, dataset=dataset, accept_truncated=accept_truncated, as_json=json,
                            sizes=_sizes(camera or ()))
    typer.echo(text)
    raise typer.Exit(code)


def _sizes(told: Sequence[str]) -> "dict[str, CameraConfig]":
    from pydantic import ValidationError

    from schemas.recipe import CameraConfig

    found: dict[str, CameraConfig] = {}
    for text in told:
        name, _, size = text.partition("=")
        width, _, height = size.partition("x")
        try:
            found[name] = CameraConfig(width=int(width), height=int(height))
        except (ValueError, ValidationError) as error:
            raise ConfigError(f"{text!r} is no camera with a size", where=f"--camera {text}",
                              mend="name it as the map does, with an even width and height: --camera head=320x240"
                              ) from error
    return found
