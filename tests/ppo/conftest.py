"""Tiny trainings of the biped: a second of CPU each."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.locomotion.tasks import load_legged_task
from pipeline.policies.resuming import newest
from pipeline.ppo.checkpoint import load
from pipeline.ppo.config import Order, PpoConfig
from pipeline.ppo.training import Training

TINY = PpoConfig(steps=6 * 64, attempts=8, ticks=8, batch=32, epochs=2, hidden=(8, 8))
"""Six iterations."""


@pytest.fixture(scope="session")
def order() -> Order:
    return Order(body="biped", name="stand", task=load_legged_task("stand"), ppo=TINY, seed=3)


@pytest.fixture(scope="session")
def straight(order, tmp_path_factory) -> Training:
    """Trained in one go; saved once, at the end."""
    return Training(order, tmp_path_factory.mktemp("straight")).run(save_every=10**6)


@pytest.fixture
def kept() -> Callable[[Path], tuple[dict, dict]]:
    """Everything in the newest checkpoint of a folder but the time it took: facts, and arrays by name."""

    def read(folder: Path) -> tuple[dict, dict]:
        saved = load(newest(folder))
        facts = {k: v for k, v in saved.facts.items() if k not in ("cpu_s", "wall_s")}
        return json.loads(json.dumps(facts)), {f"{p}/{k}": np.array(v) for p, one in saved.arrays.items()
                                               for k, v in one.items()}

    return read
