"""Training: SB3's PPO on attempts of ours, kept in checkpoints that it resumes from bit for bit."""

# SB3 and torch are only partly typed, and a resumed training has to reach into SB3's counters
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportPrivateUsage=false, reportUnknownParameterType=false

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self, override

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from pipeline.errors import PolicyError
from pipeline.locomotion.attempts import Attempts
from pipeline.locomotion.bodies import load_legged
from pipeline.policies.resuming import newest
from pipeline.ppo import checkpoint
from pipeline.ppo.checkpoint import Saved
from pipeline.ppo.config import Order, PpoConfig
from pipeline.ppo.curves import Point
from pipeline.ppo.export import build, write_policy
from pipeline.ppo.vec_env import AttemptsVecEnv

type Progress = Callable[[Point, int], None]
"""Called with the newest point and the number of steps in all."""

SAVE_EVERY = 25
"""Iterations between checkpoints."""
PARITY_ROWS = 512


class Training:
    """One training, from its beginning or from a checkpoint.

    The networks run on as many threads as the order says, the engine on `threads`; torch's and numpy's own generators,
    which SB3 draws from, are seeded here and belong to the checkpoint.

    Args:
        order: what is trained; equal orders give equal weights.
        folder: where checkpoints lie; a training goes on from the newest one there.
        threads: threads of the engine; results do not depend on them.
    """

    def __init__(self, order: Order, folder: Path, *, threads: int = 1) -> None:
        torch.set_num_threads(order.ppo.torch_threads)
        self.order, self.folder = order, folder
        attempts = Attempts(load_legged(order.body), order.task, order.ppo.attempts, seed=order.seed,
                            stratum=order.stratum, threads=threads)
        self.env = AttemptsVecEnv(attempts, order.ppo.reward_scale)
        self.model = _model(self.env, order.ppo, order.seed)
        self.curve: list[Point] = []
        self.cpu_s = self.wall_s = 0.0
        """Time spent so far, in this process and in those before it [s]."""
        if (path := newest(folder)) is not None:
            self._load(checkpoint.load(path, order.id), path)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.model.num_timesteps

    @property
    def over(self) -> bool:
        """Whether all steps are done."""
        return self.steps >= self.order.ppo.steps

    def run(self, progress: Progress | None = None, *, save_every: int = SAVE_EVERY) -> Self:
        """Train to the end, leaving checkpoints on the way.

        Args:
            progress: called after each iteration.
            save_every: iterations between checkpoints; the last one is always saved.

        Raises:
            PolicyError: the actor does not give numbers any more; the last checkpoint is older than that.
        """
        if self.over:
            return self
        left, begins = self.order.ppo.steps - self.steps, self.steps == 0
        try:
            self.model.learn(left, _Watch(self, progress, save_every), log_interval=10**9, reset_num_timesteps=begins)
        except ValueError as error:  # torch refuses to draw from a distribution of NaN
            if self.finite:
                raise
            raise PolicyError("training diverged", where=f"{self.steps} steps",
                              mend="train with a lower learning rate: --learning-rate 3e-4") from error
        self.save()
        return self

    @property
    def finite(self) -> bool:
        """Whether the actor gives numbers for what is sensed now."""
        policy, seen = self.model.policy, self.model._last_obs
        with torch.no_grad():
            mean = policy.action_net(policy.mlp_extractor.forward_actor(torch.as_tensor(np.asarray(seen))))
        return bool(torch.isfinite(mean).all() and torch.isfinite(policy.log_std.exp()).all())

    def export(self, path: Path) -> float:
        """Write the policy as ONNX; returns the largest difference to PyTorch on observations like those met.

        Raises:
            PolicyError: the difference is above 1e-5.
        """
        order, normaliser = self.order, self.env.normaliser
        weights = {k: v.detach().numpy() for k, v in self.model.policy.state_dict().items()}
        model = build(weights, normaliser, {
            "body": order.body, "task": order.task.model_dump_json(), "name": order.name, "training": order.id,
            "stratum": order.stratum or ""})
        rng = np.random.default_rng(0)
        rows = rng.normal(normaliser.mean, normaliser.std, (PARITY_ROWS, len(normaliser.mean))).astype(np.float32)
        with torch.no_grad():
            mean = self.model.policy.get_distribution(torch.from_numpy(normaliser(rows))).mode()
        return write_policy(path, model, rows, mean.numpy())

    def point(self) -> Point:
        """Close an iteration's point of the curves."""
        std = float(self.model.policy.log_std.detach().exp().mean())
        self.curve.append(self.env.tally.take(self.steps, std))
        return self.curve[-1]

    def save(self) -> Path:
        """Leave a checkpoint of this moment, which must lie between an update and the next collection."""
        model = self.model
        optimiser: dict[str, Any] = model.policy.optimizer.state_dict()
        name, keys, position, has_gauss, gauss = np.random.get_state(legacy=True)  # noqa: NPY002
        facts = {"steps": model.num_timesteps, "updates": model._n_updates, "episodes": model._episode_num,
                 "progress_left": model._current_progress_remaining, "curve": self.curve,
                 "optimiser_groups": optimiser["param_groups"],
                 "numpy": [name, int(position), int(has_gauss), float(gauss)],
                 "cpu_s": self.cpu_s, "wall_s": self.wall_s, "order": self.order.model_dump(mode="json")}
        assert model._last_obs is not None and model._last_episode_starts is not None
        arrays: dict[str, dict[str, NDArray[Any]]] = {
            "weights": {k: v.detach().numpy().copy() for k, v in model.policy.state_dict().items()},
            "optimiser": {f"{i}/{k}": v.numpy().copy() for i, one in optimiser["state"].items()
                          for k, v in one.items()},
            "normaliser": self.env.normaliser.save(),
            "attempts": self.env.attempts.save(),
            "generators": {"torch": torch.get_rng_state().numpy().copy(), "numpy": np.asarray(keys)},
            "last": {"observation": np.asarray(model._last_obs), "starts": np.asarray(model._last_episode_starts)}}
        return checkpoint.save(self.folder, self.order.id, self.steps, Saved(facts, arrays))

    def _load(self, saved: Saved, path: Path) -> None:
        model, facts, arrays = self.model, saved.facts, saved.arrays
        try:
            model.policy.load_state_dict({k: torch.from_numpy(v.copy()) for k, v in arrays["weights"].items()})
            state: dict[int, dict[str, torch.Tensor]] = {}
            for key, values in arrays.get("optimiser", {}).items():
                number, name = key.split("/")
                state.setdefault(int(number), {})[name] = torch.from_numpy(values.copy())
            model.policy.optimizer.load_state_dict({"state": state, "param_groups": facts["optimiser_groups"]})
            self.env.normaliser.load(arrays["normaliser"])
            self.env.attempts.load(arrays["attempts"])
            model._last_obs, model._last_episode_starts = arrays["last"]["observation"], arrays["last"]["starts"]
            model.num_timesteps, model._n_updates = facts["steps"], facts["updates"]
            model._episode_num, model._current_progress_remaining = facts["episodes"], facts["progress_left"]
            self.curve, self.cpu_s, self.wall_s = facts["curve"], facts["cpu_s"], facts["wall_s"]
            torch.set_rng_state(torch.from_numpy(arrays["generators"]["torch"].copy()))
            name, position, has_gauss, gauss = facts["numpy"]
            np.random.set_state((name, arrays["generators"]["numpy"], position, has_gauss, gauss))  # noqa: NPY002
        except (KeyError, ValueError, RuntimeError, TypeError) as error:
            raise PolicyError(f"checkpoint lacks what a training needs: {error}", where=path,
                              mend=checkpoint.AGAIN) from error


class _Watch(BaseCallback):
    """Closes each iteration's point, and saves between an update and the next collection."""

    def __init__(self, training: Training, progress: Progress | None, save_every: int) -> None:
        super().__init__()
        self._training, self._progress, self._every = training, progress, save_every
        self._iterations = 0
        self._cpu_s, self._wall_s = time.process_time(), time.monotonic()

    @override
    def _on_step(self) -> bool:
        return True

    @override
    def _on_rollout_start(self) -> None:
        if self._iterations and self._iterations % self._every == 0:
            self._training.save()

    @override
    def _on_rollout_end(self) -> None:
        self._iterations += 1
        training, cpu_s, wall_s = self._training, time.process_time(), time.monotonic()
        training.cpu_s, training.wall_s = (training.cpu_s + cpu_s - self._cpu_s,
                                           training.wall_s + wall_s - self._wall_s)
        self._cpu_s, self._wall_s = cpu_s, wall_s
        point = training.point()
        if self._progress is not None:
            self._progress(point, training.order.ppo.steps)


def _model(env: AttemptsVecEnv, config: PpoConfig, seed: int) -> PPO:
    def rate(left: float) -> float:
        return config.learning_rate * (config.last_rate + (1 - config.last_rate) * left)

    network: Mapping[str, Any] = {"net_arch": list(config.hidden), "activation_fn": nn.ELU,
                                  "log_std_init": config.log_std}
    return PPO("MlpPolicy", env, learning_rate=rate, n_steps=config.ticks,
               batch_size=min(config.batch, config.iteration), n_epochs=config.epochs,
               gamma=config.gamma, gae_lambda=config.gae_lambda, clip_range=config.clip, ent_coef=config.entropy,
               vf_coef=config.value, max_grad_norm=config.gradient, policy_kwargs=dict(network), seed=seed,
               device="cpu")
