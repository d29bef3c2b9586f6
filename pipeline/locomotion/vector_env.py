"""Many attempts of legged robots as a Gymnasium vector environment, all in one Batch."""

# an array of infos holds whatever the environment tells
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false

from collections.abc import Sequence
from typing import Any, override

import gymnasium as gym
import numpy as np
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from pipeline.errors import SimulationError
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.gym_env import SEEDS, LeggedEnv, privileged, total
from pipeline.locomotion.spaces import action_space, observation_space
from pipeline.locomotion.starts import draw_start
from pipeline.locomotion.tasks import LeggedTask, load_legged_task
from pipeline.locomotion.world import LeggedWorld
from pipeline.protocols import Ids
from pipeline.simulation.vector_env import one_each, reseed, tell

type Flags = NDArray[np.bool_]
type Step = tuple[NDArray[np.float32], NDArray[np.float64], Flags, Flags, dict[str, Any]]


class LeggedVectorEnv(gym.vector.VectorEnv[Any, Any, Any]):
    """n attempts side by side, equal step for step to n single environments with the same seeds.

    Attempts that ended begin anew at the next step, whose action they ignore (Gymnasium's NEXT_STEP).
    `reset(options={"start": [...]})` plays the starts that earlier info["start"] named.

    Args:
        num_envs: how many.
        body, task, stratum, max_episode_steps: as for LeggedEnv.
        threads: threads of the engine; results do not depend on them.
        render_mode: None; pictures are made by the single environment.
    """

    def __init__(self, num_envs: int = 1, body: str = "biped", task: str | LeggedTask = "stand",
                 stratum: str | None = None, *, max_episode_steps: int | None = None, threads: int = 2,
                 render_mode: None = None) -> None:
        self._body = load_legged(body)
        self._task = load_legged_task(task) if isinstance(task, str) else task
        self._stratum = stratum or next(iter(self._task.starts))
        draw_start(self._task, self._body, self._stratum, 0)
        self._limit = min(self._task.ticks, max_episode_steps or self._task.ticks)
        self._world = LeggedWorld(self._body, self._task, num_envs, threads=threads)
        self.num_envs, self.render_mode = num_envs, render_mode
        self.metadata = LeggedEnv.metadata | {"autoreset_mode": gym.vector.AutoresetMode.NEXT_STEP}
        self.single_observation_space = observation_space(self._world)
        self.single_action_space = action_space(self._world)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all, self._begun = np.arange(num_envs), False
        self._rngs: list[np.random.Generator | None] = [None] * num_envs
        self._over = np.zeros(num_envs, bool)

    @override
    def reset(self, *, seed: int | Sequence[int | None] | None = None,
              options: dict[str, Any] | None = None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """All attempts anew; an int seeds attempt i with seed + i."""
        starts = (options or {}).get("start")
        one_each(self.num_envs, "starts", starts)
        reseed(self._rngs, seed)
        self._over[:], self._begun = False, True
        infos = self._begin(self._all, starts)
        return self._world.observe(), infos

    @override
    def step(self, actions: NDArray[np.float32]) -> Step:
        """One control period of the attempts under way, and a new start for those that had ended."""
        if not self._begun:
            raise SimulationError("no attempt has begun", where="vector environment", mend="call reset() first")
        world, ended, going = self._world, np.flatnonzero(self._over), ~self._over
        world.act(np.asarray(actions, np.float64))  # those that had ended, too: they are put at a new start below
        now = world.motion()
        terms, told = world.rewards(now), privileged(now)
        reward = np.where(going, total(terms), 0.0)
        fallen = going & world.fallen(now)
        late = going & ~fallen & (world.ticks >= self._limit)
        infos = self._begin(ended, None) if len(ended) else {}
        ids = np.flatnonzero(going)
        if len(ids):
            tell(infos, self.num_envs, ids, {
                "reward_terms": {name: values[ids] for name, values in terms.items()},
                "privileged": {name: values[ids] for name, values in told.items()}})
        self._over = fallen | late
        return world.observe(), reward, fallen, late, infos

    def _begin(self, ids: Ids, starts: Sequence[int] | None) -> dict[str, Any]:
        if starts is None:
            starts = [int(rng.integers(SEEDS)) for i in ids if (rng := self._rngs[i]) is not None]
        self._world.restart(ids, [draw_start(self._task, self._body, self._stratum, int(s)) for s in starts])
        infos: dict[str, Any] = {}
        tell(infos, self.num_envs, ids, {"start": np.array([int(s) for s in starts], np.int64)})
        return infos
