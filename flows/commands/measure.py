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
    from flows.studies.shadow import run_shadow_study

    run_shadow_study(seeds=seeds, recipe=recipe, json=json)


@measure.command()
def counterfactual(
    seeds: Seeds = 8, recipe: RecipeName = "default", json: Json = None,
    pairs: Annotated[int, typer.Option(min=1, help="Pairs of policies a seed.")] = 3,
    draws: Annotated[int, typer.Option(min=4, help="Draws of each policy at each disagreement.")] = 16,
    svg: Annotated[Path | None, typer.Option(help="Draw the scatter plot into this file.")] = None,
) -> None:
    """Change of success that judged disagreements foretell, against the change measured at the exam.

    Example: hardcase measure counterfactual --seeds 8 --json calibration.json --svg calibration.svg
    """
    from flows.studies.counterfactual import run_measure

    run_measure(seeds=seeds, recipe=recipe, pairs=pairs, draws=draws, json=json, svg=svg)


@measure.command()
def estimated(
    seeds: Seeds = 8, recipe: RecipeName = "default", json: Json = None,
    most: Annotated[int, typer.Option(min=1, help="Disagreements judged of each of two pairs of policies.")] = 20,
) -> None:
    """Who was right, told from a robot's sensors alone, against the verdict from the twin's own state.

    Example: hardcase measure estimated --seeds 8 --json estimated.json
    """
    from flows.studies.estimated import run_estimated_study

    run_estimated_study(seeds=seeds, recipe=recipe, most=most, json=json)


@measure.command()
def nights(
    years: Annotated[int, typer.Option(min=1, help="Simulated years of each world.")] = 10_000,
    tries: Annotated[int, typer.Option(min=1, help="Played nights of each true gain.")] = 10_000,
    recipe: RecipeName = "nightly", json: Json = None,
    svg: Annotated[Path | None, typer.Option(help="Draw both charts into this folder.")] = None,
) -> None:
    """False promotions in years of nights under the nightly gate, and its power beside STEP and a fixed design.

    Example: hardcase measure nights --json nights.json --svg docs
    """
    from flows.studies.nights import run_nights_study

    run_nights_study(years=years, nights=tries, recipe=recipe, json=json, svg=svg)


@measure.command()
def tonight(seeds: Seeds = 8, recipe: RecipeName = "default", json: Json = None) -> None:
    """The nightly gate on the policies of finished loops, both ways round, beside what the exam says. 15 minutes.

    Example: hardcase measure tonight --seeds 8 --json tonight.json
    """
    from flows.studies.tonight import run_tonight_study

    run_tonight_study(seeds=seeds, recipe=recipe, json=json)


@measure.command()
def faces(
    threshold: Annotated[float, typer.Option(min=0.05, max=0.9, help="Score from which a find counts.")] = 0.2,
    json: Json = None,
) -> None:
    """How small a face the detector of redactions still finds, and the CPU time of a look. Needs the extra `privacy`.

    Example: hardcase measure faces --json faces.json
    """
    from flows.studies.faces import run_faces_study

    run_faces_study(threshold, json)


@measure.command()
def worth(seeds: Seeds = 8, recipe: RecipeName = "default", json: Json = None) -> None:
    """Worth of the first harvest by 8 + 8 trainings a loop, beside what the exam says.

    Example: hardcase measure worth --seeds 8 --json worth.json
    """
    from flows.studies.worth import run_batches

    run_batches(seeds=seeds, recipe=recipe, json=json)


@measure.command()
def poison(recipe: RecipeName = "default", json: Json = None) -> None:
    """Poisoned batches before every door: the checks, the worth of the batch, the gate.

    Example: hardcase measure poison --json poison.json
    """
    from flows.studies.worth import run_poisons

    run_poisons(recipe=recipe, json=json)


@measure.command()
def selection(
    loops: Annotated[int, typer.Option(min=1, help="Loops whose first harvest is halved.")] = 1,
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds of each half.")] = 8,
    recipe: RecipeName = "default", json: Json = None,
) -> None:
    """Half of a harvest kept by an influence score against half at random, against all and none of it.

    Example: hardcase measure selection --loops 1 --seeds 8 --json selection.json
    """
    from flows.studies.worth import run_selection

    run_selection(loops=loops, seeds=seeds, recipe=recipe, json=json)


@measure.command()
def act(
    seeds: Seeds = 2, recipe: RecipeName = "act", json: Json = None,
    first: Annotated[int, typer.Option(min=0, help="Number of the first seed.")] = 0,
) -> None:
    """A policy that sees on the held-out twins: variants re-rendered under looks of their own, or as they were.

    Example: hardcase measure act --seeds 2 --json act.json
    """
    from flows.studies.act import run_act_study

    run_act_study(seeds=seeds, recipe=recipe, json=json, first=first)


@measure.command()
def mining(
    seeds: Seeds = 8, recipe: RecipeName = "default", json: Json = None,
    budget: Annotated[list[int] | None, typer.Option(min=1, help="Corrections; may be given again. [default: 2, 4]")]
    = None,
) -> None:
    """A few corrections by expected value against as many at random and in turn: one lap, paired by seed. An hour.

    Example: hardcase measure mining --seeds 8 --budget 2 --budget 4 --json mining.json
    """
    from flows.studies.mining import run_mining

    run_mining(seeds=seeds, recipe=recipe, budgets=budget or (2, 4), json=json)


@measure.command()
def families(seeds: Seeds = 8, recipe: RecipeName = "default", json: Json = None) -> None:
    """Whether failure families tell known causes apart: planted ones in simulation, and the twins' own. 2 minutes.

    Example: hardcase measure families --seeds 8 --json families.json
    """
    from flows.studies.mining import run_families

    run_families(seeds=seeds, recipe=recipe, json=json)


@measure.command()
def stand(
    seeds: Annotated[int, typer.Option(min=1, help="Trainings, each of a seed of its own.")] = 3,
    body: Annotated[str, typer.Option(help="biped, unitree_h1, unitree_g1, or a path.")] = "biped",
    json: Json = None,
) -> None:
    """How often a trained robot stands through bad starts and pushes, beside zero and random actions.

    4 minutes a seed for the biped, a quarter of an hour for unitree_h1, on a core of its own.

    Example: hardcase measure stand --seeds 3 --json stand.json
    """
    from flows.studies.stand import run_stand_study

    run_stand_study(seeds=seeds, body=body, json=json)


@measure.command()
def walk(
    seeds: Annotated[int, typer.Option(min=1, help="Trainings, each of a seed of its own.")] = 3,
    body: Annotated[str, typer.Option(help="biped, unitree_h1, unitree_g1, or a path.")] = "biped",
    json: Json = None,
) -> None:
    """How well a trained robot walks at 0.5 m/s and other speeds, beside zero and random actions. 10 minutes a seed.

    Example: hardcase measure walk --seeds 3 --json walk.json
    """
    from flows.studies.walk import run_walk_study

    run_walk_study(seeds=seeds, body=body, json=json)


@measure.command()
def reference(
    seeds: Annotated[int, typer.Option(min=1, help="Trainings of each task through each vector environment.")] = 3,
    steps: Annotated[int, typer.Option(min=1, help="Environment steps of each training.")] = 1_000_000,
    episodes: Annotated[int, typer.Option(min=1, help="Deterministic episodes that each is judged on.")] = 150,
    train: Annotated[bool, typer.Option(help="Train what is not finished; or only tell of what is.")] = True,
    json: Json = None,
) -> None:
    """Gymnasium's Hopper and HalfCheetah with published numbers, through ours and DummyVecEnv. 4 CPU hours, resumes.

    Example: hardcase measure reference --seeds 3 --json reference.json
    """
    from flows.studies.reference import run_reference_study

    run_reference_study(seeds=seeds, steps=steps, episodes=episodes, train=train, json=json)


@measure.command()
def hierarchy(
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of goals and starts, and of the policies that walk.")] = 3,
    attempts: Annotated[int, typer.Option(min=1, help="Goals or starts a seed.")] = 100,
    part: Annotated[list[str] | None, typer.Option(help="arm or biped, alone; the JSON file keeps the other.")] = None,
    policy: Annotated[Path | None, typer.Option(help="ONNX file that walks, in place of the study's own.")] = None,
    json: Json = None,
    svg: Annotated[Path | None, typer.Option(help="Draw the hand's way and the tracked speed into this file.")] = None,
) -> None:
    """Commands over replaceable lower parts: IK, predictive sampling, PPO, zero action, on arm and biped. 20 minutes.

    Example: hardcase measure hierarchy --seeds 3 --json hierarchy.json --svg docs/hierarchy.svg
    """
    from flows.studies.hierarchy import run_hierarchy_study

    run_hierarchy_study(seeds=seeds, attempts=attempts, parts=tuple(part or ("arm", "biped")), policy=policy,
                        json=json, svg=svg)


@measure.command()
def warmstart(
    seeds: Annotated[int, typer.Option(min=2, help="Trainings; the teacher of one is the policy of the next.")] = 3,
    steps: Annotated[int | None, typer.Option(min=1, help="Steps of each training. [default: the task's]")] = None,
    further: Annotated[int, typer.Option(min=1, help="Steps of each training that goes on.")] = 400_000,
    json: Json = None,
) -> None:
    """PPO from cloned experts beside PPO from scratch, then on hard starts beside ordinary ones. 10 minutes a seed.

    Example: hardcase measure warmstart --seeds 3 --json warmstart.json
    """
    from flows.studies.warmstart import run_warmstart_study

    run_warmstart_study(seeds=seeds, steps=steps, further=further, json=json)


@measure.command()
def odometry(
    policy: Annotated[Path, typer.Argument(help="policy.onnx of a legged robot, or the folder of its training.")],
    twins: Annotated[list[int] | None, typer.Option("--twin", min=0, help="Twins. [default: 100, 101, 102]")] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Attempts on each twin.")] = 100,
    task: Annotated[str, typer.Option(help="What it is to do.")] = "stand",
    json: Json = None,
) -> None:
    """How far the starts that a robot's falls give are from where it truly stood. Half a minute.

    Example: hardcase measure odometry runs/biped --episodes 100 --json odometry.json
    """
    from flows.studies.odometry import run_odometry_study

    run_odometry_study(policy, twins=twins or [100, 101, 102], episodes=episodes, task=task, json=json)


@measure.command()
def legged(seeds: Seeds = 3, recipe: RecipeName = "biped", json: Json = None) -> None:
    """Falls of a legged robot on its twin, lap by lap, beside as many steps at drawn starts. 10 CPU minutes a seed.

    Example: hardcase measure legged --seeds 3 --json legged.json
    """
    from flows.studies.falls import run_falls_study

    run_falls_study(seeds=seeds, recipe=recipe, json=json)
