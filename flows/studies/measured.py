"""Finished loops of the held-out seeds: what every measurement of this project is taken on."""

import json as jsonlib
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flows.run.opening import FIRST_HELD_OUT_TWIN
from flows.run.steps import Steps, open_run
from flows.studies.study import turn
from pipeline.files import atomic
from pipeline.recipes import load_recipe
from pipeline.store import store_root


@contextmanager
def finished_loop(recipe: str, seed: int) -> Generator[Steps]:
    """The loop of one seed, turned to its end: `hardcase study` of the same recipe and store has it already.

    Twin, data and training seeds follow from the seed as they do in a study, in a store of its own; what is finished
    is not done again.

    Args:
        recipe: name or path.
        seed: number of the study's seed; its twin is 100 + seed.
    """
    loaded = load_recipe(recipe)
    folder = store_root() / "study" / Path(recipe).stem / f"store-{seed}"
    folder.parent.mkdir(parents=True, exist_ok=True)
    alone = loaded.model_copy(update={"threads": 1})
    with open_run(folder, alone, seed=seed, twin=FIRST_HELD_OUT_TWIN + seed, control=False) as steps:
        turn(steps, loaded.generations)
        yield steps


def write_json(path: Path | None, found: Any) -> None:
    """Leave the whole measurement as JSON where a path was given."""
    if path is not None:
        with atomic(path) as stream:
            stream.write(jsonlib.dumps(found, indent=1).encode() + b"\n")
