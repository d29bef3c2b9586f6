"""GYMNASIUM_TASKS: Hopper-v5 and HalfCheetah-v5 of Gymnasium on one Batch, the same bits as the originals."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import gymnasium.envs.mujoco as originals
import mujoco
import numpy as np
from gymnasium.utils import seeding
from mujoco.batch import Batch
from numpy.typing import NDArray
from pydantic import Field

from pipeline.errors import ConfigError, SimulationError, unknown
from pipeline.protocols import Array, Ids
from schemas.base import Frozen

EPISODE_TICKS = 1000
"""What Gymnasium's registration of both tasks cuts an episode off after."""


class GymnasiumTask(Frozen):
    """What a MuJoCo task of Gymnasium asks, in its order of operations; the body is the file that Gymnasium ships.

    Source: gymnasium/envs/mujoco/hopper_v5.py and half_cheetah_v5.py, Gymnasium 1.x.
    """

    file: str = Field(description="MJCF in Gymnasium's assets")
    substeps: int = Field(ge=1, description="engine steps of an action")
    alive: float | None = Field(default=None, description="reward of a tick within the limits below; no limits if None")
    effort: float = Field(ge=0, description="what the sum of squared actions costs")
    speed_most: float | None = Field(default=None, description="where observed speeds are cut off [m/s, rad/s]")
    noise: float = Field(ge=0, description="spread of the starts")
    normal_speeds: bool = Field(description="starting speeds: normal, or even like the positions")
    height_least: float = Field(default=0.0, description="of the torso [m]")
    angle_most: float = Field(default=0.0, description="of the torso to either side [rad]")
    state_most: float = Field(default=0.0, description="of all angles, heights and speeds")


GYMNASIUM_TASKS: MappingProxyType[str, GymnasiumTask] = MappingProxyType({
    "Hopper-v5": GymnasiumTask(file="hopper.xml", substeps=4, alive=1.0, effort=1e-3, speed_most=10.0, noise=5e-3,
                               normal_speeds=False, height_least=0.7, angle_most=0.2, state_most=100.0),
    "HalfCheetah-v5": GymnasiumTask(file="half_cheetah.xml", substeps=5, effort=0.1, noise=0.1, normal_speeds=True),
})
"""Gymnasium's id -> the task."""


@dataclass(frozen=True, slots=True)
class GymnasiumTick:
    """What one action brought."""

    observation: Array
    """Of episodes that ended: their new start. Shape (n, w)."""
    reward: Array
    """Shape (n,)."""
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    """As Gymnasium's TimeLimit has them: both may be true. Shape (n,)."""
    last: Array
    """Of episodes that ended: the last observation; rows as `ended`."""
    ended: Ids
    """Episodes that ended and began anew."""


class GymnasiumWorld:
    """n episodes side by side, each equal bit for bit to Gymnasium's own environment with the same seed and actions.

    Starts come from a generator for each episode, seeded and drawn from as Gymnasium does.

    Args:
        name: key of GYMNASIUM_TASKS.
        n: how many.
        threads: threads of the engine; results do not depend on them.
    """

    def __init__(self, name: str, n: int, *, threads: int = 1) -> None:
        if name not in GYMNASIUM_TASKS:
            raise unknown("task", name, list(GYMNASIUM_TASKS))
        self.name, self.task, self.n = name, GYMNASIUM_TASKS[name], n
        file = Path(originals.__file__).parent / "assets" / self.task.file
        self.model = mujoco.MjModel.from_xml_path(str(file))
        self.batch = Batch(self.model, nsim=n, nthread=threads, persistent=True)
        self.qpos, self.qvel, self._ctrl = (self.batch.bind(k) for k in ("qpos", "qvel", "ctrl"))
        data = mujoco.MjData(self.model)
        self._home: Array = data.qpos.copy()
        self._dt_s: float = self.model.opt.timestep * self.task.substeps
        self.ticks = np.zeros(n, np.int64)
        """Of the episodes under way, shape (n,)."""
        self.rngs: list[np.random.Generator] = []
        self._all = np.arange(n)

    @property
    def action_size(self) -> int:
        """How many motors there are."""
        return int(self.model.nu)

    @property
    def action_range(self) -> NDArray[np.float32]:
        """What actions are cut off at, lower and upper, shape (2, action_size)."""
        return np.ascontiguousarray(self.model.actuator_ctrlrange.T, np.float32)

    @property
    def width(self) -> int:
        """How many values an observation has: all but how far the body has come."""
        return int(self.model.nq + self.model.nv - 1)

    def begin(self, seeds: Sequence[int] | None = None) -> Array:
        """Every episode anew, as `reset(seed=...)`, or with their generators as they stand; returns the observations.

        Raises:
            ConfigError: another number of seeds than of episodes, or none where there is no generator yet.
        """
        seeds = () if seeds is None and not self.rngs else seeds
        if seeds is not None:
            if len(seeds) != self.n:
                raise ConfigError(f"{len(seeds)} seeds for {self.n} episodes", where="begin",
                                  mend="give one seed for each: begin([0, 1, ...])")
            self.rngs = [seeding.np_random(int(seed))[0] for seed in seeds]
        self._restart(self._all)
        return self.observe()

    def step(self, action: NDArray[np.float32]) -> GymnasiumTick:
        """One action each, shape (n, action_size); who has ended begins anew.

        Raises:
            SimulationError: no episode has begun, or actions of another shape.
        """
        if action.shape != self._ctrl.shape:
            raise SimulationError(f"actions of shape {action.shape}, {self.name} takes {self._ctrl.shape}",
                                  where="step", mend="send one row for each episode, one value for each motor")
        if not self.rngs:
            raise SimulationError("no episode has begun", where="step", mend="call begin([0, 1, ...]) first")
        task, before = self.task, self.qpos[:, 0].copy()
        self._ctrl[:] = action
        self.batch.step(nstep=task.substeps)
        self.ticks += 1
        healthy = self.healthy()
        speed = (self.qpos[:, 0] - before) / self._dt_s
        gained = speed if task.alive is None else speed + healthy * task.alive
        reward = gained - task.effort * np.sum(np.square(action), axis=1)  # the cost in float32, as Gymnasium has it
        terminated, truncated = ~healthy, self.ticks >= EPISODE_TICKS
        observation = self.observe()
        ended = np.flatnonzero(terminated | truncated)
        last = observation[ended]
        if len(ended):
            self._restart(ended)
            observation[ended] = self.observe()[ended]
        return GymnasiumTick(observation, reward, terminated, truncated, last, ended)

    def healthy(self) -> NDArray[np.bool_]:
        """Which bodies are within the limits of the task, shape (n,); all where it has none."""
        task = self.task
        if task.alive is None:
            return np.ones(self.n, bool)
        state = np.concatenate([self.qpos[:, 2:], self.qvel], axis=1)
        within = (np.abs(state) < task.state_most).all(axis=1)
        return within & (self.qpos[:, 1] > task.height_least) & (np.abs(self.qpos[:, 2]) < task.angle_most)

    def observe(self) -> Array:
        """Positions without the first, and speeds, shape (n, w)."""
        most = self.task.speed_most
        speeds = self.qvel if most is None else np.clip(self.qvel, -most, most)
        return np.concatenate([self.qpos[:, 1:], speeds], axis=1)

    def _restart(self, ids: Ids) -> None:
        task, noise = self.task, self.task.noise
        self.batch.reset(ids, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        for i in ids:
            rng = self.rngs[int(i)]
            self.qpos[i] = self._home + rng.uniform(-noise, noise, self._home.size)
            self.qvel[i] = (noise * rng.standard_normal(self.model.nv) if task.normal_speeds
                            else rng.uniform(-noise, noise, self.model.nv))
        self.batch.forward(ids)  # as Gymnasium does: it leaves the solver's first guess in the state
        self.ticks[ids] = 0

    def save(self) -> Mapping[str, NDArray[np.float64] | NDArray[np.uint8]]:
        """All that a restart from this very moment needs."""
        words = json.dumps([rng.bit_generator.state for rng in self.rngs])
        return {"state": self.batch.state.copy(), "ticks": self.ticks.astype(np.float64),
                "generators": np.frombuffer(words.encode(), np.uint8).copy()}

    def load(self, saved: Mapping[str, NDArray[np.float64] | NDArray[np.uint8]]) -> None:
        """Go on from what `save` gave, bit for bit."""
        self.batch.state[:] = saved["state"]
        self.ticks[:] = saved["ticks"]
        states = json.loads(saved["generators"].tobytes())
        self.rngs = [seeding.np_random(0)[0] for _ in states]
        for rng, state in zip(self.rngs, states, strict=True):
            rng.bit_generator.state = state
