"""Study: the loop beside its controls over several seeds, pooled; the numbers that docs/results.md shows."""

import json as jsonlib
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console

from flows.run.arms import ARMS, LOOP, arm_of
from flows.run.opening import FIRST_HELD_OUT_TWIN
from flows.service.estimate import turn_steps
from pipeline.errors import ConfigError
from pipeline.files import atomic
from pipeline.recipes import load_recipe
from pipeline.store import store_root
from schemas.recipe import Recipe

WORKERS = 2
"""Seeds run side by side, each on one thread: two cores are used better so than by two threads for one."""


def run_study(*, seeds: int, recipe: str, json: Path | None, arms: Sequence[str] = (),
              first: int = 0) -> dict[str, Any]:
    """Run every arm for every seed, print the pooled table, and hand back everything.

    Finished seeds are kept beside the store, so that an interrupted study goes on where it was.

    Args:
        seeds: how many; seed k has twin 100 + k, data seed k and training seeds from k.
        recipe: name or path.
        json: where to write all of it.
        arms: control arms to run beside the loop, "loop" alone for none; every one that the recipe has a use for
            where none is named.
        first: number of the first seed.

    Raises:
        ConfigError: an unknown arm, or a seed that was finished with other arms.
    """
    from flows.studies.pooling import pool, tables

    loaded, folder = load_recipe(recipe), store_root() / "study" / Path(recipe).stem
    names = (LOOP, *(name for name in arms if name != "loop")) if arms else useful(loaded)
    for name in names:
        arm_of(name)
    folder.mkdir(parents=True, exist_ok=True)
    console, results = Console(stderr=True), {}
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as workers:
        jobs = {workers.submit(study_seed, k, loaded, folder, names): k for k in range(first, first + seeds)}
        for job in as_completed(jobs):
            results[jobs[job]] = job.result()
            console.print(f"seed {jobs[job]} finished, {len(results)} of {seeds}")
    found = [results[k] for k in sorted(results)]
    pooled = pool(found, loaded)
    Console().print(tables(pooled))
    everything = {"recipe": loaded.name, "seeds": found, "pooled": pooled}
    if json is not None:
        with atomic(json) as stream:
            stream.write(jsonlib.dumps(everything, indent=1).encode() + b"\n")
    return everything


def useful(recipe: Recipe) -> tuple[str, ...]:
    """The arms that say something about this recipe: without variants, arms that only change them say nothing."""
    multiplies = recipe.augment.replays + recipe.augment.retargets > 0
    return tuple(name for name, arm in ARMS.items() if multiplies or arm.new_data != "none")


def study_seed(seed: int, recipe: Recipe, folder: Path, names: Sequence[str]) -> dict[str, Any]:
    """Every arm of one seed, in a store of its own; returns what `arm_result` gives for each."""
    from flows.run.steps import Steps, open_run

    done = folder / f"seed-{seed}.json"
    if done.exists():
        finished = jsonlib.loads(done.read_text())
        if set(finished["arms"]) != set(names):
            raise ConfigError(f"seed {seed} was finished with the arms {sorted(finished['arms'])}", where=done,
                              mend=f"name those with --arm, or remove the file: rm {done}")
        return finished
    recipe = recipe.model_copy(update={"threads": 1})
    twin, found = FIRST_HELD_OUT_TWIN + seed, dict[str, Any]()
    with open_run(folder / f"store-{seed}", recipe, seed=seed, twin=twin, control=False) as loop:
        for name in names:
            arm = loop if name == LOOP else Steps(loop.store, loop.lease, recipe, seed, twin, name, loop)
            turn(arm, 0 if ARMS[name].new_data == "none" else recipe.generations)
            found[name] = arm_result(arm)
    result = {"seed": seed, "twin": twin, "arms": found}
    with atomic(done) as stream:
        stream.write(jsonlib.dumps(result).encode())
    return result


def turn(steps: Any, last: int) -> None:
    """Every lap of one arm, without Prefect."""
    for step in turn_steps(steps.name, last, steps.recipe):
        getattr(steps, step.stage)(step.generation, _silent)


def _silent(done: int, total: int) -> None:
    """Nobody watches a study stage by stage."""


def arm_result(steps: Any) -> dict[str, Any]:
    """Lap by lap: exam of champion and candidate, scene by scene, and what the gate and the triggers said."""
    from flows.run import summary

    laps: list[Mapping[str, Any]] = []
    for g, exam in enumerate(summary.examined(steps)):
        verdict = steps.store.verdict(steps.material.ids(g, "gate")[0])
        laps.append({
            "generation": g, "robot_s": steps.robot_seconds(g), "decision": verdict.decision, "p": verdict.p,
            "gate": [r.model_dump() for r in verdict.strata], "scenes": verdict.scenes,
            "strata": exam["results"][exam["champion"]]["strata"],
            "champion": exam["results"][exam["champion"]]["bits"],
            "candidate": exam["results"][exam["candidate"]]["bits"],
            "augment": (summary.outputs(steps, g, "augment") or {}).get("report"),
            "asked": (summary.outputs(steps, g, "harvest") or {}).get("asked"),
            "wall_s": summary.wall(steps, g),
        })
    return {"says": steps.arm.says, "laps": laps,
            "triggers": [t.triggers.model_dump() if t.triggers else None for t in summary.laps(steps)]}
