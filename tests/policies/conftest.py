"""A small world with something to learn in it, and a policy that has learnt it."""

from dataclasses import dataclass

import numpy as np
import pytest

from pipeline.frames import ENVIRONMENT, STATE
from pipeline.policies.training import Fitted, fit
from schemas.recipe import TrainConfig

CHUNK = 4
SMALL = TrainConfig(chunk=CHUNK, width=32, depth=2, steps=120, batch=64, checkpoint_every=20)


@dataclass
class Reaching:
    """Hands that move towards a cube by at most 2 cm a tick and close on it, in two groups of places."""

    split: float = 0.6
    """Share of each batch from the near group; the far group comes last, as from a version's groups."""
    validation: int = 300

    def frames(self, rng: np.random.Generator, n: int, centre: float):
        state = rng.normal(0, 0.02, (n, len(STATE)))
        state[:, STATE.index("ee_x")] += centre
        environment = rng.normal(0, 0.03, (n, len(ENVIRONMENT)))
        environment[:, 0] += centre
        return state, environment

    def batch(self, rng: np.random.Generator, sizes: dict[float, int], chunk: int):
        parts = [self.frames(rng, n, centre) for centre, n in sizes.items()]
        state, environment = (np.concatenate(part).astype(np.float32) for part in zip(*parts, strict=True))
        hand = STATE.index("ee_x")
        gap = environment[:, None, :3] - state[:, None, hand:hand + 3]
        late = np.arange(chunk)[:, None] * 0.005
        closed = 0.08 * (np.abs(gap).max(2, keepdims=True) > 0.03)
        turn = np.repeat(0.1 * environment[:, None, 3:4], chunk, 1)
        actions = np.concatenate((np.clip(gap, -0.02, 0.02) * (1 - late), turn, np.repeat(closed, chunk, 1)), 2)
        mask = np.arange(chunk) < rng.integers(1, 2 * chunk, (len(state), 1))
        return state, environment, np.where(mask[..., None], actions, 1e3).astype(np.float32), mask

    def sample(self, rng: np.random.Generator, batch: int, chunk: int):
        near = round(batch * self.split)
        return self.batch(rng, {0.2: near, 0.9: batch - near}, chunk)

    def held_out(self, chunk: int):
        return self.batch(np.random.default_rng(99), {0.2: self.validation, 0.9: self.validation}, chunk)


@pytest.fixture(scope="session")
def reaching() -> Reaching:
    return Reaching()


@pytest.fixture(scope="session")
def small() -> TrainConfig:
    return SMALL


@pytest.fixture(scope="session")
def fitted(reaching: Reaching, small: TrainConfig) -> Fitted:
    return fit(reaching, small, seed=3)
