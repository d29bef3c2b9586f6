"""ARMS: Hopper and HalfCheetah as vector environments for SB3: ours on one Batch, and SB3's own over Gymnasium's."""

# SB3 and Gymnasium are only partly typed, and a resumed training has to reach into Gymnasium's wrappers
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false, reportUnknownLambdaType=false, reportMissingTypeArgument=false
# pyright: reportAttributeAccessIssue=false, reportPrivateUsage=false

import json
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, override

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from pipeline.locomotion.gymnasium_tasks import GymnasiumWorld
from pipeline.ppo.reference import Arm
from pipeline.ppo.vec_env import EngineVecEnv
from pipeline.protocols import Array

type Kept = Mapping[str, NDArray[Any]]
type Stepped = tuple[Array, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]

STATE = ("qpos", "qvel", "ctrl", "qacc_warmstart")
"""What decides how MuJoCo goes on in these two models, beside the time."""


class GymnasiumVecEnv(EngineVecEnv):
    """n episodes of a GymnasiumWorld, telling SB3 what DummyVecEnv over monitored environments would."""

    def __init__(self, world: GymnasiumWorld) -> None:
        self.world = world
        low, high = world.action_range
        self._action = np.zeros((world.n, world.action_size), np.float32)
        self._gained = np.zeros(world.n)
        super().__init__(world.n, gym.spaces.Box(-np.inf, np.inf, (world.width,), np.float64),
                         gym.spaces.Box(low, high, dtype=np.float32))

    @override
    def reset(self) -> Array:
        seeds = [int(seed) for seed in self._seeds if seed is not None]
        self._reset_seeds()
        self._gained[:] = 0
        return self.world.begin(seeds or None)

    @override
    def step_async(self, actions: NDArray[np.float32]) -> None:
        self._action = actions

    @override
    def step_wait(self) -> Stepped:
        """One step of every attempt; those that ended have begun anew, as in DummyVecEnv behind a Monitor."""
        length = self.world.ticks + 1
        tick = self.world.step(self._action)
        self._gained += tick.reward
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        for i, last in zip(tick.ended, tick.last, strict=True):
            infos[i] = {"terminal_observation": last, "episode": {"r": float(self._gained[i]), "l": int(length[i])},
                        "TimeLimit.truncated": bool(tick.truncated[i] and not tick.terminated[i])}
            self._gained[i] = 0
        return tick.observation, tick.reward.astype(np.float32), tick.terminated | tick.truncated, infos

    def save(self) -> Kept:
        """All that a restart from this very moment needs."""
        return {**self.world.save(), "gained": self._gained.copy()}

    def load(self, saved: Kept) -> None:
        """Go on from what `save` gave, bit for bit."""
        self.world.load(saved)
        self._gained[:] = saved["gained"]


class MonitoredVecEnv(DummyVecEnv):
    """SB3's DummyVecEnv over Gymnasium's own environments, as the Zoo makes it, and a way to save where it stands."""

    def __init__(self, name: str, n: int) -> None:
        super().__init__([partial(_monitored, name) for _ in range(n)])

    def save(self) -> Kept:
        """All that a restart from this very moment needs."""
        kept: dict[str, NDArray[Any]] = {}
        for i, env in enumerate(self.envs):
            data, rng = env.unwrapped.data, env.unwrapped.np_random
            kept |= {f"{i}/{name}": np.array(getattr(data, name)) for name in STATE}
            kept[f"{i}/time"], kept[f"{i}/rewards"] = np.array([data.time]), np.array(env.rewards, np.float64)
            words = json.dumps(rng.bit_generator.state)
            kept[f"{i}/generator"] = np.frombuffer(words.encode(), np.uint8).copy()
        return kept

    def load(self, saved: Kept) -> None:
        """Go on from what `save` gave, bit for bit."""
        self.reset()
        for i, env in enumerate(self.envs):
            data, limit = env.unwrapped.data, env.env
            for name in STATE:
                getattr(data, name)[:] = saved[f"{i}/{name}"]
            data.time, env.rewards = float(saved[f"{i}/time"][0]), saved[f"{i}/rewards"].tolist()
            limit._elapsed_steps = len(env.rewards)
            env.unwrapped.np_random.bit_generator.state = json.loads(saved[f"{i}/generator"].tobytes())


def _monitored(name: str) -> gym.Env[Any, Any]:
    return Monitor(gym.make(name))


def _ours(name: str, n: int) -> GymnasiumVecEnv:
    return GymnasiumVecEnv(GymnasiumWorld(name, n))


ARMS: MappingProxyType[Arm, Callable[[str, int], GymnasiumVecEnv | MonitoredVecEnv]] = MappingProxyType(
    {"ours": _ours, "dummy": MonitoredVecEnv})
"""Arm -> vector environment of a task and a number of episodes."""
