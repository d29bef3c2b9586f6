"""The commands of the nightly gate: parse, call, print."""

import json as jsonlib
from typing import Annotated

import typer

commands = typer.Typer()

Recipe = Annotated[str, typer.Option(help="Recipe with a nightly gate: a name in datasets/recipes, or a path.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the lasting run.")]
Twin = Annotated[int, typer.Option(min=0, help="Seed of the simulated real robot.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]


@commands.command()
def night(
    recipe: Recipe = "nightly", seed: Seed = 0, twin: Twin = 100,
    day: Annotated[int | None, typer.Option(min=0, help="Number of the day; the day after the last night's.")] = None,
    json: AsJson = False,
) -> None:
    """Turn tonight's lap of a lasting loop: deploy, harvest, train, and ask the nightly gate on its error budget.

    Example: hardcase night --recipe nightly
    """
    from flows.run.night_by_hand import run_night

    told = run_night(recipe=recipe, seed=seed, twin=twin, day=day)
    if json:
        typer.echo(jsonlib.dumps(told))
    else:
        typer.echo("\n".join(f"{line['stage']} {line['generation']}: {line['says']}" for line in told))


@commands.command()
def nights(recipe: Recipe = "nightly", seed: Seed = 0, twin: Twin = 100, json: AsJson = False) -> None:
    """Print the ledger of a lasting loop: what every night staked, found and left of the budget.

    Example: hardcase nights --json
    """
    from flows.run.night_by_hand import ledger, ledger_table

    rows = ledger(recipe=recipe, seed=seed, twin=twin)
    typer.echo(jsonlib.dumps([row.model_dump(mode="json") for row in rows]) if json else ledger_table(rows))
