"""Training: SB3's PPO on attempts of ours, kept in checkpoints that it resumes from bit for bit."""

# SB3 and torch are only partly typed, and a resumed training has to reach into SB3's counters
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportPrivateUsage=false, reportUnknownParameterType=false

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self, override

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback

from pipeline.errors import PolicyError
from pipeline.locomotion.attempts import Attempts
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.curriculum import StartSource
from pipeline.policies.resuming import newest
from pipeline.ppo import checkpoint
from pipeline.ppo.checkpoint import Saved
from pipeline.ppo.config import Order
from pipeline.ppo.curves import Point, update_figures
from pipeline.ppo.export import build, write_policy
from pipeline.ppo.model import model_state, ppo_model, restore_model
from pipeline.ppo.vec_env import AttemptsVecEnv
from pipeline.ppo.weights import begin_with, write_weights

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
        weights: file of the weights that the order goes on from; needed where no checkpoint lies in `folder` yet.

    Raises:
        PolicyError: the checkpoint or the weights are damaged, or not those of the order.
    """

    def __init__(self, order: Order, folder: Path, *, threads: int = 1, weights: Path | None = None) -> None:
        torch.set_num_threads(order.ppo.torch_threads)
        self.order, self.folder = order, folder
        body, curriculum = load_legged(order.body), order.curriculum
        attempts = Attempts(body, order.task, order.ppo.attempts, seed=order.seed, stratum=order.stratum,
                            draw=StartSource(curriculum, order.task, body).draw if curriculum else None,
                            vary=order.vary, threads=threads)
        self.env = AttemptsVecEnv(attempts, order.ppo.reward_scale)
        self.model = ppo_model(self.env, order.ppo, order.seed)
        self.curve: list[Point] = []
        self.cpu_s = self.wall_s = 0.0
        """Time spent so far, in this process and in those before it [s]."""
        if (path := newest(folder)) is not None:
            self._load(checkpoint.load(path, order.id), path)
        elif order.goes_on is not None:
            begin_with(self.model, self.env.normaliser, weights, order.goes_on)

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
        self.note_update()
        self.save()
        return self

    @property
    def finite(self) -> bool:
        """Whether the actor gives numbers for what is sensed now."""
        policy, seen = self.model.policy, self.model._last_obs
        with torch.no_grad():
            mean = policy.action_net(policy.mlp_extractor.forward_actor(torch.as_tensor(np.asarray(seen))))
        return bool(torch.isfinite(mean).all() and torch.isfinite(policy.log_std.exp()).all())

    @property
    def weights(self) -> dict[str, NDArray[Any]]:
        """SB3's names of actor and critic -> values."""
        return {k: v.detach().numpy() for k, v in self.model.policy.state_dict().items()}

    def leave_weights(self, path: Path) -> str:
        """Write weights and normaliser for a training that is to go on from them; returns the file's hash."""
        return write_weights(path, self.weights, self.env.normaliser)

    def export(self, path: Path) -> float:
        """Write the policy as ONNX; returns the largest difference to PyTorch on observations like those met.

        Raises:
            PolicyError: the difference is above 1e-5.
        """
        order, normaliser = self.order, self.env.normaliser
        model = build(self.weights, normaliser, {
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

    def note_update(self) -> None:
        """Add to the newest point what PPO says of the update that it led to."""
        if self.curve and (found := update_figures(self.model.logger.name_to_value)):
            self.curve[-1]["update"] = found

    def save(self) -> Path:
        """Leave a checkpoint of this moment, which must lie between an update and the next collection."""
        facts, arrays = model_state(self.model)
        facts |= {"curve": self.curve, "cpu_s": self.cpu_s, "wall_s": self.wall_s,
                  "order": self.order.model_dump(mode="json")}
        arrays |= {"normaliser": self.env.normaliser.save(), "attempts": self.env.attempts.save()}
        return checkpoint.save(self.folder, self.order.id, self.steps, Saved(facts, arrays))

    def _load(self, saved: Saved, path: Path) -> None:
        facts, arrays = saved.facts, saved.arrays
        try:
            self.env.normaliser.load(arrays["normaliser"])
            self.env.attempts.load(arrays["attempts"])
            restore_model(self.model, facts, arrays)
            self.curve, self.cpu_s, self.wall_s = facts["curve"], facts["cpu_s"], facts["wall_s"]
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
        self._training.note_update()
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
