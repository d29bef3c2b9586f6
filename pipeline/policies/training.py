"""Behaviour cloning: a chunked network fitted to batches that are drawn by source weights.

The batches of a step follow from the seed and the number of the step, not from a generator that has to
be carried along: a training resumed at any checkpoint sees the very batches an unbroken one sees, and
on one machine ends in the same bits. They are drawn in blocks by a second thread, while this one computes.
"""

from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from pipeline.errors import PolicyError
from pipeline.files import short_id
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.policies.course import Course
from pipeline.policies.network import ChunkedNet, Shape, Weights, array, tensor
from pipeline.policies.optimiser import FlatAdamW
from pipeline.policies.resuming import save_progress
from pipeline.policies.source import F32, Batch, TrainingSource
from schemas.recipe import TrainConfig

STEPS_A_BLOCK = 20
STATISTICS_ROWS, HELD_OUT_ROWS = 16384, 2048
FEATURE_FLOOR, ACTION_FLOOR = 0.03, 1e-4
"""Smallest standard deviation [m, rad or 1]: what hardly varied in training must not shout on the robot."""
FRESH, STATISTICS, TRAIN = range(3)
"""Independent streams of randomness under one seed."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A trained network and everything its files are made from."""

    shape: Shape
    weights: Weights
    action_mean: F32
    """Of the training actions, shape (5,), in the units of pipeline.frames.ACTION."""
    action_std: F32
    train_loss: tuple[tuple[int, float], ...]
    """(step, mean smooth L1 on normalised actions since the point before)."""
    held_out_loss: tuple[tuple[int, float], ...]

    def network(self) -> ChunkedNet:
        """The network with the trained weights, in evaluation mode."""
        net = ChunkedNet(self.shape).load(self.weights)
        net.eval()
        return net


@contextmanager
def deterministic(threads: int) -> Generator[None]:
    """PyTorch with a fixed thread count and deterministic kernels; what was set before comes back after."""
    # `use_deterministic_algorithms` is the same switch, but imports PyTorch's compiler first: 1 s, 110 MB.
    before, strictness = torch.get_num_threads(), torch.get_deterministic_debug_mode()
    torch.set_num_threads(threads)
    torch.set_deterministic_debug_mode("error")
    try:
        with torch.random.fork_rng(devices=[]):  # pyright: ignore[reportUnknownMemberType]
            # PyTorch draws weights of its own before we set ours.
            yield
    finally:
        torch.set_num_threads(before)
        torch.set_deterministic_debug_mode(strictness)


def _checked(batch: Batch, chunk: int) -> Batch:
    for values, shape in zip(batch, ((len(STATE),), (len(ENVIRONMENT),), (chunk, len(ACTION)), (chunk,)), strict=True):
        if values.shape[1:] != shape or not np.isfinite(values).all():
            raise PolicyError(f"training samples of shape {values.shape[1:]}, the robot has {shape}, all finite",
                              where="dataset version", mend="build the version again: hardcase build")
    return batch


def _every(batch: Batch, thin: int) -> Batch:
    state, environment, actions, mask = batch
    return state[::thin], environment[::thin], actions[::thin], mask[::thin]


class _Trainer:
    """One training: network, optimiser, statistics and where it stands."""

    def __init__(self, data: TrainingSource, config: TrainConfig, seed: int) -> None:
        self.data, self.config, self.seed = data, config, seed
        self.net = ChunkedNet(Shape(config.chunk, config.width, config.depth)).draw(self._rng(FRESH))
        state, environment, actions, mask = _checked(
            data.sample(self._rng(STATISTICS), STATISTICS_ROWS, config.chunk), config.chunk)
        flat = actions[mask].astype(np.float64)
        self.mean = flat.mean(0).astype(np.float32)
        self.std = flat.std(0).clip(ACTION_FLOOR).astype(np.float32)
        features = self.net.features(tensor(state), tensor(environment)).double()
        self.net.feature_mean.copy_(features.mean(0))
        self.net.feature_std.copy_(features.std(0, correction=0).clip(FEATURE_FLOOR))
        identity = short_id(config.model_dump_json(), seed, array(self.net.feature_mean).tobytes().hex(),
                            self.mean.tobytes().hex(), torch.__version__)
        optimiser = FlatAdamW(list(self.net.parameters()))
        rows = data.held_out(config.chunk)
        thin = max(1, -(-len(rows[0]) // HELD_OUT_ROWS))
        held_out = self.tensors(_every(rows, thin)) if len(rows[0]) else None
        self.course = Course(config, optimiser, identity,
                             (lambda: self.loss(*held_out).item()) if held_out is not None else None)

    def _rng(self, *stream: int) -> np.random.Generator:
        return np.random.default_rng((self.seed, *stream))

    def block(self, number: int) -> Batch:
        """All batches of steps [number, number + 1) * STEPS_A_BLOCK, one after another.

        Drawn at once, then dealt out in turns: a source may draw group after group, and each batch
        must hold every group by its weight.
        """
        batch = self.data.sample(self._rng(TRAIN, number), STEPS_A_BLOCK * self.config.batch, self.config.chunk)
        dealt = np.arange(len(batch[0])).reshape(self.config.batch, STEPS_A_BLOCK).T.ravel()
        state, environment, actions, mask = batch
        return state[dealt], environment[dealt], actions[dealt], mask[dealt]

    def tensors(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        """Normalised features (b, k), normalised actions (b, chunk * 5), 0 where padded, and the mask alike."""
        state, environment, actions, mask = batch
        keep = np.repeat(mask.astype(np.float32), len(ACTION), 1)
        target = ((actions - self.mean) / self.std).reshape(keep.shape) * keep
        with torch.no_grad():
            features = self.net.normalised(tensor(state), tensor(environment))
        return features, tensor(target), tensor(keep)

    def loss(self, features: Tensor, target: Tensor, keep: Tensor) -> Tensor:
        """Mean smooth L1 over what is not padding."""
        total = F.smooth_l1_loss(self.net.layers(features) * keep, target, reduction="sum")
        return total / keep.sum()

    def update(self, features: Tensor, target: Tensor, keep: Tensor) -> None:
        """One step."""
        loss = self.loss(features, target, keep)
        loss.backward()  # pyright: ignore[reportUnknownMemberType]
        self.course.advance(loss.item())

    def blocks(self) -> Iterator[tuple[int, tuple[Tensor, Tensor, Tensor]]]:
        """(first step, tensors) of every block from here on; the next is drawn while one is used."""
        first, last = self.course.step // STEPS_A_BLOCK, (self.config.steps - 1) // STEPS_A_BLOCK
        with ThreadPoolExecutor(1) as pool:
            coming = pool.submit(self.block, first)
            for number in range(first, last + 1):
                batch = coming.result()
                if number < last:
                    coming = pool.submit(self.block, number + 1)
                yield number * STEPS_A_BLOCK, self.tensors(batch)


def fit(data: TrainingSource, config: TrainConfig, seed: int, *, resume_from: Path | None = None,
        checkpoints: Path | None = None, progress: Callable[[int, int, float], None] | None = None,
        threads: int = 1) -> Fitted:
    """Train a chunked policy by behaviour cloning.

    Args:
        data: what to learn from, weights by source inside.
        config: steps, batch, network and learning rate.
        seed: decides weights and batches; nothing else does.
        resume_from: a checkpoint of this same training, see pipeline.policies.resuming.newest.
        checkpoints: folder for resumable checkpoints, every `config.checkpoint_every` steps.
        progress: called as (steps done, steps in all, last training loss) every few dozen steps.
        threads: of PyTorch; another number may give other bits.

    Raises:
        PolicyError: samples do not fit the robot, the checkpoint is of another training, or training diverges.
    """
    with deterministic(threads):
        trainer = _Trainer(data, config, seed)
        if resume_from is not None:
            trainer.course.resume(resume_from)
        for start, block in trainer.blocks():
            for step in range(max(start, trainer.course.step), min(start + STEPS_A_BLOCK, config.steps)):
                rows = slice((step - start) * config.batch, (step - start + 1) * config.batch)
                trainer.update(*(part[rows] for part in block))
                if checkpoints is not None and trainer.course.step % config.checkpoint_every == 0:
                    save_progress(checkpoints, trainer.course.identity, trainer.course.progress())
            if progress is not None:
                progress(trainer.course.step, config.steps, trainer.course.last_loss)
        return Fitted(trainer.net.shape, trainer.net.weights(), trainer.mean, trainer.std,
                      tuple(trainer.course.train_loss), tuple(trainer.course.held_out_loss))
