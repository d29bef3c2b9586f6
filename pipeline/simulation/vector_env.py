"""Many attempts as a Gymnasium vector environment, all in one Batch."""

# an array of infos holds whatever the environment tells
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false

from collections.abc import Mapping, Sequence
from typing import Any, override

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.frames import ACTION
from pipeline.protocols import Ids
from pipeline.simulation.gym_env import (
    PickPlaceEnv,
    Seen,
    Starts,
    action_space,
    observation_space,
    seen,
    total,
    usable,
)
from pipeline.simulation.physics import from_draws
from pipeline.simulation.tasks import load_task
from pipeline.simulation.world import World

type Flags = NDArray[np.bool_]
type Step = tuple[Seen, NDArray[np.float64], Flags, Flags, dict[str, Any]]


class PickPlaceVectorEnv(gym.vector.VectorEnv[Any, Any, Any]):
    """n attempts side by side, equal step for step to n single environments with the same seeds.

    Attempts that ended begin anew at the next step, whose action they ignore (Gymnasium's NEXT_STEP).
    `reset(options={"scenes": [SceneSpec, ...]})` plays those very starts.

    Args:
        num_envs: how many.
        robot, scene, task, stratum, randomize, max_episode_steps: as for PickPlaceEnv.
        threads: threads of the engine; results do not depend on them.
        render_mode: None; pictures are made by the single environment.
    """

    def __init__(self, num_envs: int = 1, robot: str = "arm", scene: str = "table", task: str = "pick-place",
                 stratum: str = "common", *, randomize: bool = False, max_episode_steps: int | None = None,
                 threads: int = 2, render_mode: None = None) -> None:
        self._starts = Starts(robot=robot, scene=scene, task=task, stratum=stratum, randomize=randomize)
        self._starts.draw(np.random.default_rng(0))
        self.num_envs, self._threads, self.render_mode = num_envs, threads, render_mode
        self.metadata = PickPlaceEnv.metadata | {"autoreset_mode": gym.vector.AutoresetMode.NEXT_STEP}
        ticks = load_task(task).ticks
        self._limit = min(ticks, max_episode_steps or ticks)
        self.single_observation_space, self.single_action_space = observation_space(), action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._setup, self._all = self._starts.setup(), np.arange(num_envs)
        self._rngs: list[np.random.Generator | None] = [None] * num_envs
        self._over = np.zeros(num_envs, bool)
        self._world: World | None = None

    @override
    def reset(self, *, seed: int | Sequence[int | None] | None = None,
              options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:
        """All attempts anew; an int seeds attempt i with seed + i."""
        scenes = (options or {}).get("scenes")
        one_each(self.num_envs, "scenes", scenes)
        reseed(self._rngs, seed)
        self._over[:] = False
        infos = self._begin(self._all, scenes)
        return seen(self._running(), self._all), infos

    @override
    def step(self, actions: NDArray[np.float32]) -> Step:
        """One control period of the attempts under way, and a new start for those that had ended."""
        world, action = self._running(), usable(actions, (self.num_envs, len(ACTION)))
        going, ended = np.flatnonzero(~self._over), np.flatnonzero(self._over)
        reward, success, late = np.zeros(self.num_envs), np.zeros(self.num_envs, bool), np.zeros(self.num_envs, bool)
        infos = self._begin(ended, None) if len(ended) else {}
        if len(going):
            world.act(action[going], going)
            terms = world.rewards(going)
            reward[going], success[going] = total(terms), world.succeeded(going)
            late[going] = world.command.ticks[going] >= self._limit
            tell(infos, self.num_envs, going, {"is_success": success[going], "reward_terms": terms})
        self._over = success | late
        return seen(world, self._all), reward, success, late, infos

    def _begin(self, ids: Ids, scenes: Sequence[Any] | None) -> dict[str, Any]:
        rngs = [rng for i in ids if (rng := self._rngs[i]) is not None]
        specs = tuple(map(self._starts.draw, rngs) if scenes is None else map(self._starts.exactly, scenes))
        if self._world is None:
            self._world = self._starts.world(self._setup, specs, self._threads)
        else:
            self._world.restart(ids, specs, from_draws([s.draws for s in specs]))
        infos: dict[str, Any] = {}
        told = np.array([s.model_dump_json() for s in specs], object)
        tell(infos, self.num_envs, ids, {"is_success": np.zeros(len(ids), bool), "scene": told})
        return infos

    def _running(self) -> World:
        if self._world is None:
            raise ConfigError("no attempt has begun", where="vector environment", mend="call reset() first")
        return self._world


def one_each(n: int, name: str, given: Sequence[Any] | None) -> None:
    """ConfigError where something was given, but not one for each of n attempts."""
    if given is not None and len(given) != n:
        raise ConfigError(f"{len(given)} {name} for {n} attempts", where="reset", mend=f"give {n} {name}")


def reseed(rngs: list[np.random.Generator | None], seed: int | Sequence[int | None] | None) -> None:
    """Begin the generator of every attempt that has a new seed, or none yet; an int seeds attempt i with seed + i.

    Raises:
        ConfigError: there is another number of seeds than of attempts.
    """
    seeds = [seed + i for i in range(len(rngs))] if isinstance(seed, int) else seed or [None] * len(rngs)
    one_each(len(rngs), "seeds", seeds)
    for i, one in enumerate(seeds):
        if one is not None or rngs[i] is None:
            rngs[i] = seeding.np_random(one)[0]


def tell(infos: dict[str, Any], n: int, ids: Ids, values: Mapping[str, Any]) -> None:
    """Add the values of some of n attempts as Gymnasium's vector infos: an array of all, and a mask of whose it is."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            tell(infos.setdefault(name, {}), n, ids, value)
        else:
            nothing = None if value.dtype == object else 0
            infos.setdefault(name, np.full((n, *value.shape[1:]), nothing, value.dtype))[ids] = value
        infos.setdefault(f"_{name}", np.zeros(n, bool))[ids] = True
