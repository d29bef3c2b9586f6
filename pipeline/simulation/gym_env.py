"""One attempt as a Gymnasium environment: what a policy sees, what it may do, and what it is worth."""

# mujoco is a compiled package without type stubs
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false

from collections.abc import Mapping
from functools import reduce
from operator import add
from typing import Any, override

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError, SimulationError
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.protocols import Array, Ids
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import Setup, compose
from pipeline.simulation.physics import from_draws, randomize
from pipeline.simulation.rendering import CLOSE_UP, FilmCamera
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from pipeline.simulation.world import CONTROL_HZ, LIMITS, OPEN_M, World
from schemas.base import Frozen
from schemas.scene import SceneSpec

type Seen = dict[str, NDArray[np.float32]]

FAR_M, TURNS_RAD = 10.0, 4 * np.pi
"""What no position [m] and no angle [rad] of this robot, table and cube exceeds: bounds of the observation."""
STARTS, PHYSICS = 0x67796D, 13
"""Words that keep the seeds of these starts and of their physics apart from all other seeds."""
PICTURE_PX = (320, 240)
"""Width and height of a rendered picture."""

type Scenes = tuple[SceneSpec, ...]


class Starts(Frozen):
    """Which attempts an environment draws."""

    robot: str = "arm"
    scene: str = "table"
    task: str = "pick-place"
    stratum: str = "common"
    randomize: bool = False

    def draw(self, rng: np.random.Generator) -> SceneSpec:
        """The next start, and the physics drawn for it where they are randomized."""
        seed = scene_seed("study", STARTS, int(rng.integers(2**62)))
        spec = sample_scene(self.task, "study", seed, self.stratum, robot=self.robot, scene=self.scene)
        if not self.randomize:
            return spec
        return spec.model_copy(update={"draws": randomize(np.random.default_rng([seed, PHYSICS]))})

    def exactly(self, spec: SceneSpec) -> SceneSpec:
        """The start itself; ConfigError where this environment cannot play it as it is."""
        for name in ("robot", "scene", "task"):
            if getattr(spec, name) != getattr(self, name):
                raise ConfigError(f"the start is for {name} {getattr(spec, name)!r}, the environment has "
                                  f"{getattr(self, name)!r}", where=f"scene {spec.seed}",
                                  mend=f"make the environment with {name}={getattr(spec, name)!r}")
        if spec.twin is not None:
            raise ConfigError(f"the start belongs to twin {spec.twin}, whose physics no environment knows",
                              where=f"scene {spec.seed}", mend="play it nominally: model_copy(update={'twin': None})")
        return spec

    def setup(self) -> Setup:
        """The compiled robot in its scene."""
        return compose(load_body(self.robot), self.scene)

    def world(self, setup: Setup, scenes: Scenes, threads: int) -> World:
        """The attempts side by side."""
        return World(setup, scenes, from_draws([s.draws for s in scenes]), threads=threads)


def observation_space() -> gym.spaces.Dict:
    """agent_pos and environment_state: see pipeline.frames.STATE and ENVIRONMENT."""

    def box(names: tuple[str, ...]) -> gym.spaces.Box:
        angle = [name.startswith("joint") or name.endswith("yaw") for name in names]
        high = np.where(angle, TURNS_RAD, FAR_M).astype(np.float32)
        return gym.spaces.Box(-high, high, dtype=np.float32)

    return gym.spaces.Dict({"agent_pos": box(STATE), "environment_state": box(ENVIRONMENT)})


def action_space() -> gym.spaces.Box:
    """Motion of the commanded pose [m, m, m, rad] and finger opening [m]; see pipeline.frames.ACTION."""
    low, high = np.array([*-LIMITS, 0.0]), np.array([*LIMITS, OPEN_M])
    return gym.spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def seen(world: World, ids: Ids) -> Seen:
    """What the robots of these attempts perceive, by the names of the observation space."""
    observation = world.observe(ids)
    return {"agent_pos": observation.state.astype(np.float32),
            "environment_state": observation.environment.astype(np.float32)}


def total(rewards: Mapping[str, Array]) -> Array:
    """Sum of the reward terms, in their order; Python's own sum() would round scalars and arrays differently."""
    return reduce(add, rewards.values())


def usable(action: object, shape: tuple[int, ...]) -> Array:
    """The action as the world takes it; SimulationError for another shape or a value that is not finite."""
    values = np.asarray(action, np.float64)
    if values.shape != shape:
        raise SimulationError(f"action of shape {values.shape}, the robot takes {shape}", where="step",
                              mend=f"send {', '.join(ACTION)} for each attempt")
    if not np.isfinite(values).all():
        raise SimulationError("action holds a value that is not finite", where="step",
                              mend="look at the policy: its weights or its input hold NaN or infinity")
    return values


class PickPlaceEnv(gym.Env[Any, Any]):
    """Pick up the cube and put it on the mark, at 20 Hz; observations are as perceived, never the truth.

    `reset(seed=...)` gives the same attempt again; `reset(options={"scene": SceneSpec})` plays that very start. The
    reward is the sum of the task's terms, each of which is in info["reward_terms"].

    Args:
        robot, scene, task, stratum: what is drawn; ConfigError lists the valid names.
        randomize: draw the physics of every attempt from RANDOMIZATIONS; nominal otherwise.
        max_episode_steps: length limit [ticks]; never longer than the task's own.
        render_mode: "rgb_array" or None.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": int(CONTROL_HZ)}  # noqa: RUF012

    def __init__(self, robot: str = "arm", scene: str = "table", task: str = "pick-place", stratum: str = "common", *,
                 randomize: bool = False, max_episode_steps: int | None = None,
                 render_mode: str | None = None) -> None:
        self._starts = Starts(robot=robot, scene=scene, task=task, stratum=stratum, randomize=randomize)
        self._starts.draw(np.random.default_rng(0))  # a wrong name is told here, not at the first reset
        config = load_task(task)
        self.task_description, self._limit = config.instruction, min(config.ticks, max_episode_steps or config.ticks)
        self.observation_space, self.action_space = observation_space(), action_space()
        self.render_mode = render_mode
        self._setup, self._ids = self._starts.setup(), np.zeros(1, np.intp)
        self._world: World | None = None
        self._camera: FilmCamera | None = None

    @override
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:
        """The next attempt; info["scene"] is its SceneSpec as JSON."""
        super().reset(seed=seed)
        spec = (options or {}).get("scene")
        spec = self._starts.draw(self.np_random) if spec is None else self._starts.exactly(spec)
        if self._world is None:
            self._world = self._starts.world(self._setup, (spec,), threads=1)
        else:
            self._world.restart(self._ids, (spec,), from_draws([spec.draws]))
        return self._seen(self._world), {"is_success": False, "scene": spec.model_dump_json()}

    @override
    def step(self, action: NDArray[np.float32]) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """One control period; terminated on success, truncated at the limit."""
        world = self._running()
        if world.command.ticks[0] >= self._limit:
            raise SimulationError("the attempt is over", where=f"tick {self._limit}", mend="call reset() first")
        world.act(usable(action, (len(ACTION),))[None], self._ids)
        rewards = world.rewards(self._ids)
        terms = {name: float(value[0]) for name, value in rewards.items()}
        success = bool(world.succeeded(self._ids)[0])
        over = bool(world.command.ticks[0] >= self._limit)
        info: dict[str, Any] = {"is_success": success, "reward_terms": terms}
        return self._seen(world), float(total(rewards)[0]), success, over, info

    @override
    def render(self) -> NDArray[np.uint8] | None:
        """The workspace now, (240, 320, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        world = self._running()
        if self._camera is None:
            self._camera = FilmCamera(world.batch.get_model(0), camera=CLOSE_UP, width=PICTURE_PX[0],
                                      height=PICTURE_PX[1])
        world.batch.get_model(0, self._camera.model)  # the cube may have another size than before
        return np.ascontiguousarray(self._camera.frames(world.batch.state)[0])

    @override
    def close(self) -> None:
        """Free what rendering holds."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _running(self) -> World:
        if self._world is None:
            raise SimulationError("no attempt has begun", where="environment", mend="call reset() first")
        return self._world

    def _seen(self, world: World) -> Seen:
        return {name: values[0] for name, values in seen(world, self._ids).items()}
