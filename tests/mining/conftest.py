"""A small loop, turned once: its failures, families, corrections and candidates."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from flows.run.steps import Steps, open_run
from flows.studies.study import turn
from pipeline.recipes import load_recipe
from pipeline.trace import Trace

RECIPE = """
name: mined
generations: 1
threads: 1
collect: {demonstrations: 10}
augment: {replays: 12, retargets: 20, per_correction: 4}
train: {chunk: 8, steps: 200, batch: 128, checkpoint_every: 200}
gate: {looks: [12], bootstrap_success: 0.0}
deploy: {episodes: 14, rare_share: 0.3, shadow: false}
harvest: {corrections: 3, order: value}
exam: {common: 4, rare: 2}
"""


@pytest.fixture(scope="session")
def root(tmp_path_factory) -> Path:
    """The store of a loop of two laps."""
    folder = tmp_path_factory.mktemp("mined")
    (folder / "mined.yaml").write_text(RECIPE)
    with open_run(folder / "store", load_recipe(str(folder / "mined.yaml")), seed=3, twin=4, control=False) as steps:
        turn(steps, 1)
    return folder / "store"


@pytest.fixture
def steps(root) -> Iterator[Steps]:
    """The stages of that loop, under its lease."""
    recipe = load_recipe(str(root.parent / "mined.yaml"))
    with open_run(root, recipe, seed=3, twin=4, control=False) as opened:
        yield opened


@pytest.fixture
def attempt() -> Callable[..., Trace]:
    """Writes the course of an attempt at a cube at x = 0.30 m by hand: what its robot would have sensed."""

    def written(*, tool: float | np.ndarray = 0.005, opening: float | np.ndarray = 0.04,
                lifted: float | np.ndarray = 0.0, carried: float | np.ndarray = 0.0, ticks: int = 40,
                start: tuple[float, float] = (0.30, 0.0), half: float = 0.02) -> Trace:
        state, seen = np.zeros((ticks, 16)), np.zeros((ticks, 7))
        seen[:, 0], seen[:, 1], seen[:, 2] = start[0], start[1] + np.asarray(carried), half + np.asarray(lifted)
        seen[:, 4:6] = start[0], start[1] + 0.2
        state[:, 7:10] = seen[:, :3]
        state[:, 7] += tool
        state[:, 6] = opening
        empty = np.zeros((ticks, 0))
        return Trace(20.0, state, seen, np.zeros((ticks, 5)), np.zeros((ticks, 7)), np.zeros((ticks, 7)),
                     np.zeros((ticks, 7)), (), np.zeros((ticks, 0, 7)), ("reach",) * ticks, {}, empty, empty)

    return written
