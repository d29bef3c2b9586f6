"""`hardcase measure`: the studies behind docs/results.md that are not the loop beside its controls."""

from pathlib import Path
from typing import Annotated

import typer

measure = typer.Typer(no_args_is_help=True)

Seeds = Annotated[int, typer.Option(min=1, help="Seeds: twin, data and training together.")]
RecipeName = Annotated[str, typer.Option("--recipe", help="Recipe: a name in datasets/recipes, or a path.")]
Json = Annotated[Path | None, typer.Option("--json", help="Write everything to this file as JSON.")]


@measure.callback()
def about() -> None:
    """Measure what the parts of the loop are worth, on the finished loops of a study's seeds. Takes minutes to hours.

    Example: hardcase measure --help
    """


@measure.command()
def shadow(seeds: Seeds = 8, recipe: RecipeName = "default", json: Json = None) -> None:
    """What the signals of shadow mode know of a failure before it happens: AUROC by signal and window. 10 minutes.

    Example: hardcase measure shadow --seeds 8 --json shadow.json
    """
    from flows.shadow_study import run_shadow_study

    run_shadow_study(seeds=seeds, recipe=recipe, json=json)
