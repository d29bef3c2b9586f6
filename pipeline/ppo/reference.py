"""ZOO, PUBLISHED: the numbers that others train Hopper and HalfCheetah with, and the returns that they publish."""

from types import MappingProxyType
from typing import Literal

from pydantic import Field

from pipeline.files import short_id
from pipeline.ppo.config import PpoConfig
from schemas.base import Frozen

type Task = Literal["Hopper-v5", "HalfCheetah-v5"]
"""A key of GYMNASIUM_TASKS."""
type Arm = Literal["ours", "dummy"]
"""Whose vector environment: ours on one Batch, or SB3's DummyVecEnv over Gymnasium's own environments."""

PUBLISHED: MappingProxyType[Task, float] = MappingProxyType({"Hopper-v5": 2410.435, "HalfCheetah-v5": 5819.099})
"""Mean return of the Zoo's trained agent, one run each of 150 deterministic episodes, on the v3 environments.

Source: DLR-RM/rl-baselines3-zoo, benchmark.md.
"""

ZOO: MappingProxyType[Task, PpoConfig] = MappingProxyType({
    "Hopper-v5": PpoConfig(
        steps=1_000_000, attempts=1, ticks=512, batch=32, epochs=5, learning_rate=9.80828e-05, last_rate=1, gamma=0.999,
        gae_lambda=0.99, clip=0.2, entropy=0.00229519, value=0.835671, gradient=0.7, reward_scale=1,
        hidden=(256, 256), log_std=-2),
    "HalfCheetah-v5": PpoConfig(
        steps=1_000_000, attempts=1, ticks=512, batch=64, epochs=20, learning_rate=2.0633e-05, last_rate=1, gamma=0.98,
        gae_lambda=0.92, clip=0.1, entropy=0.000401762, value=0.58096, gradient=0.8, reward_scale=1,
        hidden=(256, 256), log_std=-2)})
"""Task -> the Zoo's tuned numbers; with them go ReLU, plain initial weights and `normalize: true`.

Source: DLR-RM/rl-baselines3-zoo, hyperparams/ppo.yml, commit 208b6fd, entries Hopper-v4 and HalfCheetah-v4.
"""


class ReferenceOrder(Frozen):
    """One training of the reference: the same order gives the same weights."""

    task: Task
    arm: Arm = Field(description="whose vector environment")
    ppo: PpoConfig
    seed: int = Field(ge=0)

    @property
    def id(self) -> str:
        """What the checkpoints of this training are known by."""
        return short_id(self.model_dump_json())
