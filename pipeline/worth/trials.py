"""Many trials, two side by side, each kept when it is done: what was cut off goes on where it was.

A trial is found again by what it learns from and what it plays, not by the version or batch that asked for it: the
policies without a batch are those of the version before it, and are trained once for all that is compared with them.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import pipeline
from pipeline.files import atomic, short_id, source_hash
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.policies.table import policy_kind
from pipeline.worth.trial import Played, play
from schemas.recipe import Recipe, TrainConfig
from schemas.scene import SceneSpec

type Progress = Callable[[int, int], None]

PROCESSES = 2
"""Trials side by side, each on one thread."""
FEW = 3
"""Trials that are not worth the start of other processes, which takes as long as half of one."""

SOURCES = ("worth/trial.py", "worth/trials.py", "triggers.py",
           *(f"simulation/{name}.py" for name in ("bodies", "kinematics", "model", "physics", "rollout", "scenes",
                                                  "tasks", "world")))
"""Files of pipeline/, beside the policy's own, that decide how a trial ends."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One training and the scenes that its policy plays."""

    data: TrainingData
    seed: int


def run_trials(trials: Sequence[Trial], recipe: Recipe, scenes: Sequence[SceneSpec], *, keep: Path,
               processes: int = PROCESSES, progress: Progress | None = None) -> list[Played]:
    """Train and play every trial; those that are kept already are only read.

    Args:
        trials: in any order; results come back in it.
        recipe: its train section trains, its harvest section names failures.
        scenes: what every policy plays.
        keep: folder of finished trials.
        processes: side by side; 1 runs in this process.
        progress: told (trials done, trials in all).

    Raises:
        PolicyError: a training diverges.
    """
    learnt = {id(t.data): digest(t.data, recipe.train.chunk) for t in trials}
    files = [keep / f"{_id(learnt[id(t.data)], t.seed, recipe, scenes)}.json" for t in trials]
    left = {file: trial for file, trial in zip(files, trials, strict=True) if not file.exists()}
    told = progress or _silent
    told(len(files) - len(left), len(files))
    if processes > 1 and len(left) > FEW:
        with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as workers:
            jobs = [workers.submit(_one, trial, recipe, scenes, file) for file, trial in left.items()]
            for done, job in enumerate(as_completed(jobs), len(files) - len(left) + 1):
                job.result()
                told(done, len(files))
    else:
        for done, (file, trial) in enumerate(left.items(), len(files) - len(left) + 1):
            _one(trial, recipe, scenes, file)
            told(done, len(files))
    return [_read(file) for file in files]


def digest(data: TrainingData, chunk: int) -> str:
    """A hash over every training sample and the shares of the groups: all that a training sees."""
    seen = hashlib.sha256()
    for name, rows in data.rows.items():
        seen.update(f"{name} {data.weights[name]!r} {rows.size}".encode())
        for part in data.gather(rows, chunk):
            seen.update(np.ascontiguousarray(part).data)
    return seen.hexdigest()


def code_hash(train: TrainConfig) -> str:
    """Hash of the sources that decide how a trial ends."""
    root = Path(pipeline.__path__[0])
    return source_hash(root / name for name in (*policy_kind(train.policy).sources, *SOURCES))


def _id(learnt: str, seed: int, recipe: Recipe, scenes: Sequence[SceneSpec]) -> str:
    return short_id("trial", learnt, seed, recipe.train.model_dump_json(), recipe.harvest.model_dump_json(),
                    code_hash(recipe.train), *(s.model_dump_json() for s in scenes))


def _one(trial: Trial, recipe: Recipe, scenes: Sequence[SceneSpec], file: Path) -> None:
    """Train, play, and keep how it ended."""
    kind = policy_kind(recipe.train.policy)
    fitted = kind.fit(trial.data, recipe.train, trial.seed, resume_from=None, checkpoints=None, progress=None)
    with TemporaryDirectory(prefix="hardcase-") as folder:
        kind.export(fitted, Path(folder) / "policy.onnx")
        played = play(kind.open(Path(folder) / "policy.onnx"), scenes, recipe.harvest)
    with atomic(file) as stream:
        stream.write(json.dumps({"solved": "".join("01"[int(s)] for s in played.solved),
                                 "families": played.families}).encode())


def _read(file: Path) -> Played:
    kept = json.loads(file.read_text())
    return Played(np.array([bit == "1" for bit in kept["solved"]]), tuple(kept["families"]))


def _silent(done: int, total: int) -> None:
    """Nobody watches."""
