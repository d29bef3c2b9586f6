"""ReferenceTraining: one training of the reference, through ours or through SB3's DummyVecEnv, and its evaluation.

Both arms hold the same SB3 PPO within the same VecNormalize, because its arithmetic (running reward scale, +-10 cut)
belongs to the Zoo's numbers and our Normaliser's is another. Its own `save` is never called: it would pickle.
"""

# SB3 and torch are only partly typed
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false

import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self, override

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from pipeline.errors import PolicyError
from pipeline.files import sha256
from pipeline.locomotion.evaluation import evaluation_seed
from pipeline.locomotion.gymnasium_tasks import GymnasiumWorld
from pipeline.policies.resuming import newest
from pipeline.ppo import checkpoint
from pipeline.ppo.checkpoint import Saved
from pipeline.ppo.model import model_state, ppo_model, restore_model
from pipeline.ppo.reference import ReferenceOrder
from pipeline.ppo.reference_envs import ARMS

type Point = tuple[int, float]
"""Steps so far, mean return of the last 100 episodes while exploring."""
type Told = Callable[[Point], None]

SAVE_EVERY, POINT_EVERY = 100, 20
"""Iterations between checkpoints, and between points of the curve."""
RECENT = 100
"""Episodes that a point is the mean of."""


class ReferenceTraining:
    """One training, from its beginning or from a checkpoint, which it resumes from bit for bit.

    Args:
        order: what is trained.
        folder: where checkpoints lie.
    """

    def __init__(self, order: ReferenceOrder, folder: Path) -> None:
        torch.set_num_threads(order.ppo.torch_threads)
        self.order, self.folder = order, folder
        self.env = ARMS[order.arm](order.task, order.ppo.attempts)
        self.normalised = VecNormalize(self.env, gamma=order.ppo.gamma)
        self.model = ppo_model(self.normalised, order.ppo, order.seed, activation=nn.ReLU, orthogonal=False)
        self.curve: list[Point] = []
        self.cpu_s = self.wall_s = 0.0
        """Time spent so far, in this process and in those before it [s]."""
        if (path := newest(folder)) is not None:
            self._load(checkpoint.load(path, order.id), path)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.model.num_timesteps

    def run(self, told: Told | None = None, *, save_every: int = SAVE_EVERY) -> Self:
        """Train to the end, leaving checkpoints on the way; `told` gets each point of the curve."""
        left = self.order.ppo.steps - self.steps
        if left > 0:
            self.model.learn(left, _Watch(self, told, save_every), log_interval=10**9,
                             reset_num_timesteps=self.steps == 0)
            self.save()
        return self

    def evaluate(self, episodes: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Returns and lengths of deterministic episodes that no training meets, the normaliser frozen.

        Both arms are judged on a GymnasiumWorld of their own, which is equal to Gymnasium's environments bit for bit.
        """
        world = GymnasiumWorld(self.order.task, episodes)
        gained, length, alive = np.zeros(episodes), np.zeros(episodes, np.int64), np.ones(episodes, bool)
        seen = world.begin([evaluation_seed(seed, k) for k in range(episodes)])
        while alive.any():
            action, _ = self.model.predict(np.asarray(self.normalised.normalize_obs(seen)), deterministic=True)
            tick = world.step(action.astype(np.float32))
            gained += alive * tick.reward
            length += alive
            alive[tick.ended] = False
            seen = tick.observation
        return gained, length

    @property
    def digest(self) -> str:
        """Of all weights and of what observations are normalised by: equal where two trainings are, bit for bit."""
        parts = [v.detach().numpy() for v in self.model.policy.state_dict().values()]
        observed = self.normalised.obs_rms
        assert isinstance(observed, RunningMeanStd)
        return sha256(b"".join(np.ascontiguousarray(p).tobytes() for p in (*parts, observed.mean, observed.var)))

    def point(self) -> Point:
        """Close a point of the curve."""
        recent = [episode["r"] for episode in self.model.ep_info_buffer or ()]
        self.curve.append((self.steps, float(np.mean(recent)) if recent else float("nan")))
        return self.curve[-1]

    def save(self) -> Path:
        """Leave a checkpoint of this moment, which must lie between an update and the next collection."""
        facts, arrays = model_state(self.model)
        facts |= {"curve": self.curve, "cpu_s": self.cpu_s, "wall_s": self.wall_s,
                  "recent": [[e["r"], e["l"]] for e in self.model.ep_info_buffer or ()],
                  "order": self.order.model_dump(mode="json")}
        arrays |= {"normaliser": _normaliser(self.normalised), "episodes": dict(self.env.save())}
        return checkpoint.save(self.folder, self.order.id, self.steps, Saved(facts, arrays))

    def _load(self, saved: Saved, path: Path) -> None:
        facts, arrays = saved.facts, saved.arrays
        try:
            _restore_normaliser(self.normalised, arrays["normaliser"])
            self.env.load(arrays["episodes"])
            restore_model(self.model, facts, arrays)
            self.model.ep_info_buffer = deque(({"r": r, "l": n} for r, n in facts["recent"]), RECENT)
            self.model.ep_success_buffer = deque(maxlen=RECENT)  # SB3 makes both or none
            self.curve = [(int(step), float(value)) for step, value in facts["curve"]]
            self.cpu_s, self.wall_s = facts["cpu_s"], facts["wall_s"]
        except (KeyError, ValueError, RuntimeError, TypeError) as error:
            raise PolicyError(f"checkpoint lacks what a training needs: {error}", where=path,
                              mend=checkpoint.AGAIN) from error


class _Watch(BaseCallback):
    """Points of the curve, and checkpoints between an update and the next collection."""

    def __init__(self, training: ReferenceTraining, told: Told | None, save_every: int) -> None:
        super().__init__()
        self._training, self._told, self._every = training, told, save_every
        self._iterations = training.steps // training.order.ppo.iteration
        self._cpu_s, self._wall_s = time.process_time(), time.monotonic()
        self._fresh = True

    @override
    def _on_step(self) -> bool:
        return True

    @override
    def _on_rollout_start(self) -> None:
        self._clock()
        if self._iterations % self._every == 0 and not self._fresh:
            self._training.save()
        self._fresh = False

    @override
    def _on_rollout_end(self) -> None:
        self._iterations += 1
        if self._iterations % POINT_EVERY == 0:
            point = self._training.point()
            if self._told is not None:
                self._told(point)

    @override
    def _on_training_end(self) -> None:
        self._clock()

    def _clock(self) -> None:
        training, cpu_s, wall_s = self._training, time.process_time(), time.monotonic()
        training.cpu_s, training.wall_s = (training.cpu_s + cpu_s - self._cpu_s,
                                           training.wall_s + wall_s - self._wall_s)
        self._cpu_s, self._wall_s = cpu_s, wall_s


def _normaliser(env: VecNormalize) -> dict[str, NDArray[Any]]:
    observed, returned = env.obs_rms, env.ret_rms
    assert isinstance(observed, RunningMeanStd)
    return {"mean": observed.mean.copy(), "var": observed.var.copy(), "count": np.array([observed.count]),
            "return": np.array([returned.mean, returned.var, returned.count], np.float64),
            "returns": env.returns.copy()}


def _restore_normaliser(env: VecNormalize, saved: dict[str, NDArray[Any]]) -> None:
    observed, returned = env.obs_rms, env.ret_rms
    assert isinstance(observed, RunningMeanStd)
    observed.mean, observed.var = saved["mean"].copy(), saved["var"].copy()
    observed.count = float(saved["count"][0])
    mean, var, returned.count = saved["return"].tolist()
    returned.mean, returned.var = np.float64(mean), np.float64(var)  # pyright: ignore[reportAttributeAccessIssue]
    env.returns = saved["returns"].copy()
