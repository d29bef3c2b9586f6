"""Small plants, and a walking policy that nobody trained."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.control.arm import ArmPlant
from pipeline.control.reaches import Reach, draw_reaches
from pipeline.locomotion.biped import biped
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.tasks import WALK
from pipeline.ppo.export import build
from pipeline.ppo.normaliser import Normaliser

WIDTH, JOINTS = 9 + 3 * 10 + 2, 10


@pytest.fixture(scope="session")
def body() -> LeggedBody:
    return biped()


@pytest.fixture(scope="session")
def reaches() -> dict[bool, list[Reach]]:
    """The same three goals with perturbed physics and without."""
    return {perturbed: draw_reaches(3, 5, perturbed=perturbed) for perturbed in (False, True)}


@pytest.fixture
def arms(reaches) -> Callable[[bool], ArmPlant]:
    return lambda perturbed: ArmPlant(reaches[perturbed])


@pytest.fixture(scope="session")
def walker(tmp_path_factory) -> Path:
    """A policy of the biped's walk with weights from a generator; it moves, and falls."""
    rng, hidden = np.random.default_rng(0), 8
    weights = {"mlp_extractor.policy_net.0.weight": rng.normal(0, 0.2, (hidden, WIDTH)),
               "mlp_extractor.policy_net.0.bias": rng.normal(0, 0.2, hidden),
               "action_net.weight": rng.normal(0, 0.2, (JOINTS, hidden)), "action_net.bias": np.zeros(JOINTS)}
    path = tmp_path_factory.mktemp("walker") / "policy.onnx"
    path.write_bytes(build(weights, Normaliser(WIDTH), {"body": "biped", "task": WALK.model_dump_json(),
                                                        "name": "walk", "training": "none", "stratum": ""}))
    return path
