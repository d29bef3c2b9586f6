"""The verbs of a lap, one stage by hand each: the same steps as the flow's, without Prefect."""

import json as jsonlib
from typing import Annotated, Any

import typer

Recipe = Annotated[str | None, typer.Option(help="Recipe: a name in datasets/recipes, or a path. [default: default]")]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed of data and training. [default: 0]")]
Twin = Annotated[int | None, typer.Option(min=0, help="Seed of the simulated real robot. [default: 100]")]
Policy = Annotated[str | None, typer.Option(help="Kind of policy to train: chunked, or act. [default: the recipe's]")]
Run = Annotated[str | None, typer.Option(help="Id of a run that was begun before. [default: the newest]")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]


def _stage(
    name: str, run: str | None, recipe: str | None, seed: int | None, twin: int | None, *, as_json: bool,
    policy: str | None = None,
) -> None:
    """Run one stage of the current generation by hand: the same steps as the flow's, without Prefect."""
    from flows.commands.by_hand import run_stage

    _print(run_stage(name, run=run, recipe=recipe, seed=seed, twin=twin, policy=policy), as_json)


def _print(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        typer.echo(jsonlib.dumps(result))
    else:
        kept = " (kept)" if result["resumed"] else ""
        typer.echo(f"generation {result['generation']} {result['stage']}: {result['says']}{kept}")
        for id in result["ids"][:5]:
            typer.echo(f"  {id}")
        if len(result["ids"]) > 5:
            typer.echo(f"  and {len(result['ids']) - 5} more (--json lists them)")


def collect(run: Run = None, recipe: Recipe = None, policy: Policy = None, seed: Seed = None, twin: Twin = None,
            json: AsJson = False) -> None:
    """Record scripted demonstrations; begins a new run when a recipe, policy, seed or twin is given.

    Example: hardcase collect --recipe smoke --seed 1
    """
    _stage("collect", run, recipe, seed, twin, as_json=json, policy=policy)


def augment(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
            json: AsJson = False) -> None:
    """Make variants of what is new and keep those that succeed.

    Example: hardcase augment
    """
    _stage("augment", run, recipe, seed, twin, as_json=json)


def build(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
          json: AsJson = False) -> None:
    """Build the dataset version of this generation, a LeRobot v3 folder.

    Example: hardcase build --json
    """
    _stage("build", run, recipe, seed, twin, as_json=json)


def train(run: Run = None, recipe: Recipe = None, policy: Policy = None, seed: Seed = None, twin: Twin = None,
          json: AsJson = False) -> None:
    """Train the candidate and export it to ONNX; with --policy, that of the newest run which trains this kind.

    Example: hardcase train --policy act
    """
    _stage("train", run, recipe, seed, twin, as_json=json, policy=policy)


def gate(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
         json: AsJson = False) -> None:
    """Test the candidate against the champion on the same scenes.

    Example: hardcase gate --json
    """
    _stage("gate", run, recipe, seed, twin, as_json=json)


def release(
    run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
    rollback: Annotated[bool, typer.Option("--rollback", help="Go back to the champion before this one.")] = False,
    json: AsJson = False,
) -> None:
    """Move the champion pointer if the gate says so.

    Example: hardcase release --rollback
    """
    if rollback:
        from flows.commands.by_hand import roll_back

        _print(roll_back(run=run), json)
    else:
        _stage("release", run, recipe, seed, twin, as_json=json)


def deploy(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
           json: AsJson = False) -> None:
    """Let the champion work on the twin and record every attempt.

    Example: hardcase deploy
    """
    _stage("deploy", run, recipe, seed, twin, as_json=json)


def harvest(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
            json: AsJson = False) -> None:
    """Find the hard cases of the last deployment and have them corrected.

    Example: hardcase harvest --json
    """
    _stage("harvest", run, recipe, seed, twin, as_json=json)


def exam(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
         json: AsJson = False) -> None:
    """Examine the champion on the twin starts that no decision reads.

    Example: hardcase exam
    """
    _stage("exam", run, recipe, seed, twin, as_json=json)


def report(run: Run = None, recipe: Recipe = None, seed: Seed = None, twin: Twin = None,
           json: AsJson = False) -> None:
    """Write the HTML report of a run and print its path.

    Example: hardcase report
    """
    _stage("report", run, recipe, seed, twin, as_json=json)


VERBS = (collect, augment, build, train, gate, release, deploy, harvest, exam, report)
"""In the order of `hardcase --help`."""
