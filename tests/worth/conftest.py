"""A loop of two laps, tiny, turned once; each test that writes gets a copy of its store."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from flows.run.steps import Steps, open_run
from flows.studies.study import turn
from pipeline.recipes import load_recipe, recipe_from
from schemas.recipe import Recipe

TINY = {
    "generations": 2, "threads": 1, "collect": {"demonstrations": 5}, "gate": {"looks": [20], "bootstrap_success": 0.0},
    "augment": {"replays": 4, "retargets": 4, "per_correction": 2}, "train": {"steps": 40, "width": 32, "batch": 64},
    "deploy": {"episodes": 16, "shadow": False}, "harvest": {"corrections": 3}, "exam": {"common": 4, "rare": 2},
}


@pytest.fixture(scope="session")
def tiny() -> Recipe:
    return recipe_from(load_recipe("smoke").model_dump() | TINY, "tests/worth")


@pytest.fixture(scope="session")
def turned(tiny, tmp_path_factory) -> Path:
    """The store of a finished lap 0 and 1."""
    root = tmp_path_factory.mktemp("worth") / "store"
    with open_run(root, tiny, seed=0, twin=3, control=False) as steps:
        turn(steps, 1)
    return root


@pytest.fixture
def root(turned, tmp_path, monkeypatch) -> Path:
    """A copy of it, and the store that commands use."""
    copy = tmp_path / "store"
    shutil.copytree(turned, copy)
    monkeypatch.setenv("HARDCASE_STORE", str(copy))
    return copy


@pytest.fixture
def steps(root, tiny) -> Iterator[Steps]:
    with open_run(root, tiny, seed=0, twin=3, control=False) as opened:
        yield opened
