"""One attempt of a legged robot as a Gymnasium environment: what it senses, what it may do, what it is worth."""

# mujoco is a compiled package without type stubs
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false

from collections.abc import Mapping
from typing import Any, override

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SimulationError
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.rewards import Motion
from pipeline.locomotion.spaces import action_space, observation_space
from pipeline.locomotion.starts import draw_start
from pipeline.locomotion.tasks import LeggedTask, load_legged_task
from pipeline.locomotion.world import LeggedWorld
from pipeline.protocols import Array
from pipeline.simulation.rendering import FilmCamera, View

CONTROL_HZ = 50
"""Control rate of the tasks that are registered [Hz]."""
PICTURE_PX = (320, 240)
"""Width and height of a rendered picture."""
FAR = 2.8
"""How far the camera stands from the robot, in heights of its base."""
SEEDS = 2**62
"""Seeds of starts are drawn below this."""


class LeggedEnv(gym.Env[Any, Any]):
    """A legged robot on level ground; observations are what a real one has: IMU, encoders, its own last action.

    `reset(seed=...)` gives the same attempt again, `reset(options={"start": ...})` the start that an earlier
    info["start"] named. The reward is the sum of the task's terms, each of which is in info["reward_terms"]. What only
    a simulator knows is in info["privileged"] and never in the observation.

    Args:
        body: key of LEGGED, or a path to an MJCF or URDF file; ConfigError lists the valid names.
        task: key of LEGGED_TASKS, or a task of your own.
        stratum: kind of start; the task's first where None.
        max_episode_steps: length limit [ticks]; never longer than the task's own.
        render_mode: "rgb_array" or None.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # noqa: RUF012

    def __init__(self, body: str = "biped", task: str | LeggedTask = "stand", stratum: str | None = None, *,
                 max_episode_steps: int | None = None, render_mode: str | None = None) -> None:
        self._body = load_legged(body)
        self._task = load_legged_task(task) if isinstance(task, str) else task
        self._stratum = stratum or next(iter(self._task.starts))
        draw_start(self._task, self._body, self._stratum, 0)  # a wrong name is told here, not at the first reset
        self._limit = min(self._task.ticks, max_episode_steps or self._task.ticks)
        self._world, self._ids = LeggedWorld(self._body, self._task, 1), np.zeros(1, np.intp)
        self.task_description, self.render_mode = self._task.instruction, render_mode
        self.observation_space, self.action_space = observation_space(self._world), action_space(self._world)
        self._begun, self._over = False, False
        self._camera: FilmCamera | None = None

    @override
    def reset(self, *, seed: int | None = None,
              options: dict[str, Any] | None = None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """The next attempt; info["start"] is the seed that draws its start."""
        super().reset(seed=seed)
        start = (options or {}).get("start")
        start = int(self.np_random.integers(SEEDS)) if start is None else int(start)
        self._world.restart(self._ids, [draw_start(self._task, self._body, self._stratum, start)])
        self._begun, self._over = True, False
        return self._world.observe()[0], {"start": start}

    @override
    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """One control period; terminated by a fall, truncated at the limit."""
        world = self._running()
        if self._over:
            raise SimulationError("the attempt is over", where=f"tick {world.ticks[0]}", mend="call reset() first")
        world.act(np.asarray(action, np.float64)[None])
        now = world.motion()
        terms = world.rewards(now)
        fallen = bool(world.fallen(now)[0])
        late = not fallen and bool(world.ticks[0] >= self._limit)
        self._over = fallen or late
        info: dict[str, Any] = {
            "reward_terms": {name: float(values[0]) for name, values in terms.items()},
            "privileged": {name: values[0] for name, values in privileged(now).items()}}
        return world.observe()[0], float(total(terms)[0]), fallen, late, info

    @override
    def render(self) -> NDArray[np.uint8] | None:
        """The robot from the side, (240, 320, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        world = self._running()
        if self._camera is None:
            self._camera = FilmCamera(world.batch.get_model(0), width=PICTURE_PX[0], height=PICTURE_PX[1])
        x, y = world.position()[0, :2]
        tall = self._body.height_m
        self._camera.look(View(look_at_m=(float(x), float(y), tall * 0.9), distance_m=FAR * tall, azimuth_deg=130.0,
                               elevation_deg=-12.0))
        return np.ascontiguousarray(self._camera.frames(world.batch.state)[0])

    @override
    def close(self) -> None:
        """Free what rendering holds."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _running(self) -> LeggedWorld:
        if not self._begun:
            raise SimulationError("no attempt has begun", where="environment", mend="call reset() first")
        return self._world


def privileged(now: Motion) -> Mapping[str, NDArray[Any]]:
    """What only a simulator knows of each attempt: for critics, judges and reports, not for policies."""
    return {"velocity": now.velocity, "height": now.height, "contact": now.contact}


def total(terms: Mapping[str, Array]) -> Array:
    """Sum of the reward terms, in their order, shape (n,)."""
    return np.sum(list(terms.values()), axis=0)
