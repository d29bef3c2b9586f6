"""Study: the loop beside its controls over several seeds, pooled; the numbers that docs/results.md shows."""

import json as jsonlib
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

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
              first: int = 0, worth_scenes: int | None = None) -> dict[str, Any]:
    """Run every arm for every seed, print the pooled table, and hand back everything.

    Finished seeds are kept beside the store, so that an interrupted study goes on where it was.

    Args:
        seeds: how many; seed k has twin 100 + k, data seed k and training seeds from k.
        recipe: name or path.
        json: where to write all of it.
        arms: control arms to run beside the loop, "loop" alone for none; every one that the recipe has a use for
            where none is named.
        first: number of the first seed.
        worth_scenes: that each training of the last batch's verdict plays; as many as ever where None.

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
        jobs = {workers.submit(_seed_and_worth, k, loaded, folder, names, worth_scenes): k
                for k in range(first, first + seeds)}
        for job in as_completed(jobs):
            results[jobs[job]] = job.result()
            console.print(f"seed {jobs[job]} finished, {len(results)} of {seeds}")
    found = [results[k][0] for k in sorted(results)]
    worths = [results[k][1] for k in sorted(results)]
    pooled = pool(found, loaded)
    Console().print(tables(pooled))
    Console().print(worth_table(worths))
    everything = {"recipe": loaded.name, "seeds": found, "pooled": pooled, "worths": worths}
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
    from flows.run.steps import open_run

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
            arm = loop if name == LOOP else type(loop)(loop.store, loop.lease, recipe, seed, twin, name, loop)
            turn(arm, 0 if ARMS[name].new_data == "none" else recipe.generations)
            found[name] = arm_result(arm)
    result = {"seed": seed, "twin": twin, "arms": found}
    with atomic(done) as stream:
        stream.write(jsonlib.dumps(result).encode())
    return result


def _seed_and_worth(seed: int, recipe: Recipe, folder: Path, names: Sequence[str],
                    scenes: int | None) -> tuple[dict[str, Any], Any]:
    return study_seed(seed, recipe, folder, names), full_worth(seed, recipe, folder, scenes)


def full_worth(seed: int, recipe: Recipe, folder: Path, scenes: int | None = None) -> dict[str, Any] | None:
    """What the last batch of a finished loop is worth by 8 + 8 trainings, of which a loop makes only one.

    None where no lap added anything, or where the policy is of a kind whose batches are not judged.
    """
    from flows.run.steps import open_run
    from flows.run.worth import judge
    from flows.run.worth_batch import of_lap
    from stages.worth import SCENES

    done = folder / f"worth-{seed}.json"
    if done.exists():
        return jsonlib.loads(done.read_text())
    if recipe.train.policy != "chunked":
        return None
    alone = recipe.model_copy(update={"threads": 1})
    with open_run(folder / f"store-{seed}", alone, seed=seed, twin=FIRST_HELD_OUT_TWIN + seed, control=False) as loop:
        laps = ((g, of_lap(loop, g)) for g in range(recipe.generations, 0, -1))
        lap, batch = next(((g, b) for g, b in laps if b is not None), (0, None))
        if batch is None:
            return None
        verdict = judge(loop.store, batch, scenes=scenes or SCENES, processes=1)
        result = {"seed": seed, "lap": lap, "worth": verdict.model_dump(mode="json")}
    with atomic(done) as stream:
        stream.write(jsonlib.dumps(result).encode())
    return result


def worth_table(worths: Sequence[dict[str, Any] | None]) -> Table:
    """Verdicts on the last batches for people."""
    shown = Table("seed", "lap", "episodes", "verdict", "why", title="The last batch of each loop, with it against "
                  "without it, 8 + 8 trainings")
    for one in filter(None, worths):
        verdict = one["worth"]
        shown.add_row(str(one["seed"]), str(one["lap"]), str(len(verdict["episodes"])), verdict["decision"],
                      verdict["reason"])
    return shown


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
