"""One lap of the study of mining: some corrections of a finished loop's first failures, one training, one exam."""

import json as jsonlib
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from flows.run import facts
from flows.run.mining import Attempt, mined_at
from flows.run.steps import Steps
from pipeline.files import atomic
from pipeline.frames import Frames
from pipeline.mining.happened import MARKED
from pipeline.policies.table import policy_kind
from pipeline.recording import read_frames
from pipeline.simulation.tasks import load_task
from schemas.episode import Episode
from schemas.hardcase import HardCase
from schemas.recipe import Recipe
from stages.augment import augment
from stages.build import build
from stages.exam import exam
from stages.harvest import hard_cases, harvest
from stages.mine import Mined
from stages.train import train

type Said = dict[str, Any]
type Way = tuple[str, int, str]
"""Order, corrections, and where they begin."""

STUDY = "mining study"
"""Arm of everything that is made here."""


def lap(steps: Steps, way: Way, folder: Path) -> Said:
    """Correct some failures of generation 0 in one way, learn from it, and sit the exam; generation 0 is shared.

    Nothing reaches the loop's own store; what is finished is kept in `folder` and not done again.

    Args:
        steps: a finished loop.
        way: how the corrections are chosen, how many, and where they begin.
        folder: where results are kept.
    """
    order, count, aim = way
    kept = folder / f"{order}-{count}-{aim}-{steps.seed}.json"
    if kept.exists():
        return jsonlib.loads(kept.read_text())
    harvest_config = steps.recipe.harvest.model_copy(update={"corrections": count, "order": order, "aim": aim})
    recipe = steps.recipe.model_copy(update={"harvest": harvest_config})
    attempts = steps.material.failed_attempts(0)
    mined = mined_at(steps, 0, hard_cases(attempts, 0, STUDY), attempts)
    with TemporaryDirectory(dir=steps.store.tmp) as work:
        said = _learnt(steps, recipe, attempts, mined, Path(work))
    with atomic(kept) as stream:
        stream.write(jsonlib.dumps({"way": list(way), "seed": steps.seed, **said}).encode())
    return jsonlib.loads(kept.read_text())


def _learnt(steps: Steps, recipe: Recipe, attempts: Sequence[Attempt], mined: Mined, work: Path) -> Said:
    done = harvest(attempts, recipe, twin=steps.twin, generation=0, folder=work, software=facts.software("harvest"),
                   arm=STUDY, judged=mined.cases, ranked=[place.case for place in mined.queue])
    new = [(r.episode, read_frames(r.path)[1]) for r in done.recorded]
    marked = {c.correction for c in done.cases if c.subtask in MARKED} if recipe.harvest.aim == "subtask" else set()
    policy, variants = _trained(steps, recipe, new, {str(id) for id in marked}, [e for e, _ in attempts], work)
    found = exam(policy_kind(recipe.train.policy).open(policy), recipe, seed=steps.seed, twin=steps.twin)
    names = {f.id: f.name for f in mined.new}
    return {"bits": "".join("01"[int(s)] for s in found.success), "strata": list(found.strata), "variants": variants,
            "corrected": sum(c.corrected for c in done.cases), "chosen": [_chosen(c, names) for c in done.chosen]}


def _chosen(case: HardCase, names: dict[str, str]) -> Said:
    return {"case": case.id, "family": names.get(case.found or ""), "stratum": case.stratum, "subtask": case.subtask}


def _trained(steps: Steps, recipe: Recipe, new: Sequence[tuple[Episode, Frames]], marked: set[str],
             parents: Sequence[Episode], work: Path) -> tuple[Path, int]:
    """The candidate as the loop would train it: variants near what is new, all data so far, the lap's seed."""
    base = steps.store.episodes(steps.material.version(0).episodes)
    frames = {e.id: steps.material.frames(e) for e in base}
    near = [(e, f) for e, f in new if e.outcome.label == "success"]
    made = augment([(e, frames[e.id]) for e in base if e.origin == "scripted"], recipe.augment, replays=0,
                   retargets=recipe.augment.per_correction * len(near), seed=steps.seed, generation=1,
                   threads=recipe.threads, near=near, same_mark=marked, arm=STUDY) if near else None
    kept = [e for e in made.episodes if e.outcome.label == "success"] if made else []
    shard = [e.model_copy(update={"blob": "0" * 64}) for e in kept]  # their frames are at hand: no shard is written
    known = frames | {e.id: f for e, f in new} | {e.id: made.frames[e.id] for e in kept if made}
    version = build([*base, *(e for e, _ in new), *shard, *parents], known, recipe, store=work,
                    task=load_task(recipe.task).instruction, generation=1, consents=steps.material.consents())
    data = policy_kind(recipe.train.policy).load(work / version.path, steps.material.consents())
    record = train(version, data, recipe.train, seed=1000 * steps.seed + 1, store=work)
    return work / record.checkpoint / "policy.onnx", len(kept)


def rates(said: Said, names: Sequence[str]) -> float:
    """Success over some strata of an exam, every scene counting the same."""
    strata, bits = np.array(said["strata"]), np.array([b == "1" for b in said["bits"]])
    return float(bits[np.isin(strata, names)].mean())
