"""Behaviour cloning of ACT from one camera and the robot's own state.

As in pipeline.policies.training the batches of a step follow from the seed and the number of the step, so that a
training resumed at any checkpoint ends in the same bits on one machine.

In training a second, linear head on the backbone's features says where cube and mark are, seen from the hand, as the
demonstrator perceived them. Actions alone say that too seldom and too indirectly for the few minutes that we have. The
head is thrown away afterwards: the policy is shown pictures and the robot's own state, and nothing else.

Pictures are shifted by up to SHIFT_PX at random, hand and cube together: what counts is where one is from the other.
With both, the places of cubes that were never seen were wrong by 6 to 7 mm after 500 steps, without by 17 to 19 mm.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
import torch.nn.functional as F
from lerobot.policies.act.modeling_act import ACTPolicy  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import NDArray
from torch import Tensor, nn

from pipeline.errors import ConfigError, PolicyError
from pipeline.files import short_id
from pipeline.footage import FEATURE
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.lerobot_view.augmenting import Augment
from pipeline.policies.act_net import CHANNELS, ActShape, load, measure_norms, narrow, weights_of
from pipeline.policies.course import Course
from pipeline.policies.network import Weights, tensor
from pipeline.policies.optimiser import FlatAdamW
from pipeline.policies.resuming import save_progress
from pipeline.policies.training import deterministic
from schemas.recipe import TrainConfig

type F32 = NDArray[np.float32]

STATISTICS_ROWS, HELD_OUT_ROWS = 512, 256
FLOOR, ACTION_FLOOR, PIXEL_FLOOR = 1e-3, 1e-4, 1.0
"""Smallest standard deviation of what is normalised [m or rad; 1 of 255 for pixels]."""
LONGEST_GRADIENT = 10.0
"""lerobot's own limit of the gradient's norm."""
SHIFT_PX = 4
"""Source: Kostrikov et al. 2020, DrQ, for pictures of 84x84."""
HINT = 0.5
"""Weight of the loss of the head that says where cube and mark are."""
SYMMETRY = 4.0
"""A square cube is the same after a turn of 2 pi / 4."""
HAND = STATE.index("ee_x")
STATISTICS, TRAIN = 1, 2
"""Independent streams of randomness under one seed."""


class PictureSource(Protocol):
    """A dataset version with pictures; see pipeline.lerobot_view.samples.Samples."""

    @property
    def films(self) -> Mapping[str, Any]:
        """Picture feature -> its frames."""
        ...

    @property
    def held_out_rows(self) -> NDArray[np.intp]:
        """Rows of the validation split."""
        ...

    def draw(self, rng: np.random.Generator, batch: int) -> NDArray[np.intp]:
        """Rows by their chances."""
        ...

    def gather(self, rows: NDArray[np.intp], deltas: Mapping[str, Sequence[int]], augment: Augment | None = None,
               rng: np.random.Generator | None = None, pictures: Any = "float") -> dict[str, NDArray[Any]]:
        """The samples of these rows."""
        ...


@dataclass(frozen=True, slots=True)
class Scales:
    """Mean and standard deviation of what goes in and comes out."""

    pixel_mean: F32
    """Of the pictures' channels, in [0, 255], shape (3,)."""
    pixel_std: F32
    state_mean: F32
    """Of observation.state, shape (16,)."""
    state_std: F32
    action_mean: F32
    """Of the training actions, shape (5,), in the units of pipeline.frames.ACTION."""
    action_std: F32


@dataclass(frozen=True, slots=True)
class FittedAct:
    """A trained policy and everything its files are made from."""

    shape: ActShape
    weights: Weights
    """By their names in lerobot's ACTPolicy, in the shapes of the narrow backbone."""
    scales: Scales
    train_loss: tuple[tuple[int, float], ...]
    """(step, mean L1 on normalised actions since the point before)."""
    held_out_loss: tuple[tuple[int, float], ...]

    def policy(self) -> ACTPolicy:
        """The narrow policy with the trained weights, in evaluation mode."""
        return load(narrow(self.shape), self.weights)


def _shape(data: PictureSource, config: TrainConfig) -> ActShape:
    if len(data.films) != 1:
        raise ConfigError(f"ACT takes one camera, the version has {len(data.films)}", where="dataset.cameras",
                          mend="name one camera in the recipe: dataset.cameras.close: {width: 96, height: 96}")
    (feature, films), = data.films.items()
    _, height, width, _ = films[0].shape
    return ActShape(feature.removeprefix(FEATURE), height, width, config.chunk, config.width, config.depth,
                    config.shrink)


def _moments(values: NDArray[Any], floor: float) -> tuple[F32, F32]:
    flat = values.reshape(-1, values.shape[-1]).astype(np.float64)
    return flat.mean(0).astype(np.float32), flat.std(0).clip(floor).astype(np.float32)


def places(state: F32, environment: F32) -> F32:
    """What the hint is about: cube x, y, z and mark x, y from the hand [m], and the cube's yaw as a square has it.

    Args:
        state: observation.state, shape (b, 16).
        environment: observation.environment_state, shape (b, 7).

    Returns:
        Shape (b, 7).
    """
    hand, yaw = state[:, HAND:HAND + 3], SYMMETRY * environment[:, ENVIRONMENT.index("object_yaw"), None]
    return np.concatenate([environment[:, :3] - hand, environment[:, 4:6] - hand[:, :2], np.cos(yaw), np.sin(yaw)],
                          axis=1).astype(np.float32)


class _Trainer:
    """One training: policy, optimiser, statistics and where it stands."""

    def __init__(self, data: PictureSource, config: TrainConfig, seed: int) -> None:
        self.data, self.config, self.seed = data, config, seed
        self.shape = _shape(data, config)
        self.deltas = {"action": range(config.chunk)}
        self.scales, self.hint_scale, seen = self._statistics()
        torch.manual_seed(seed)  # pyright: ignore[reportUnknownMemberType]
        self.policy = narrow(self.shape)
        pixels = CHANNELS // self.shape.shrink * math.ceil(self.shape.height / 32) * math.ceil(self.shape.width / 32)
        self.head = nn.Linear(pixels, len(self.hint_scale[0]))
        self.features: Tensor | None = None
        model: Any = self.policy.model
        model.backbone.register_forward_hook(self._keep)
        measure_norms(self.policy, self.pictures(seen))
        identity = short_id(
            config.model_dump_json(), seed, torch.__version__, self.shape,
            *(getattr(self.scales, name).tobytes().hex() for name in Scales.__slots__))
        self.policy.train()
        optimiser = FlatAdamW([*self.policy.parameters(), *self.head.parameters()])
        thin = max(1, -(-len(data.held_out_rows) // HELD_OUT_ROWS))
        rows = data.held_out_rows[::thin]
        held_out = self.tensors(rows) if len(rows) else None
        self.course = Course(config, optimiser, identity,
                             (lambda: self.losses(*held_out)[0].item()) if held_out is not None else None)

    def _statistics(self) -> tuple[Scales, tuple[F32, F32], NDArray[np.uint8]]:
        rows = self.data.draw(np.random.default_rng((self.seed, STATISTICS)), STATISTICS_ROWS)
        found = self.data.gather(rows, self.deltas, pictures="bytes")
        state, actions = found["observation.state"], found["action"]
        for values, width in ((state, len(STATE)), (actions, len(ACTION))):
            if values.shape[-1] != width or not np.isfinite(values).all():
                raise PolicyError(f"training samples of {values.shape[-1]} values, the robot has {width}, all finite",
                                  where="dataset version", mend="build the version again: hardcase build")
        seen = found[self.shape.feature]
        scales = Scales(*_moments(seen.transpose(0, 2, 3, 1), PIXEL_FLOOR), *_moments(state, FLOOR),
                        *_moments(actions[~found["action_is_pad"]], ACTION_FLOOR))
        return scales, _moments(places(state, found["observation.environment_state"]), FLOOR), seen

    def _keep(self, backbone: nn.Module, given: object, found: dict[str, Tensor]) -> None:
        self.features = found["feature_map"]

    def pictures(self, seen: NDArray[np.uint8]) -> Tensor:
        """Normalised pictures (b, 3, height, width), channels last in memory: a fifth faster."""
        rows = seen.transpose(0, 2, 3, 1)
        return tensor((rows - self.scales.pixel_mean) / self.scales.pixel_std).permute(0, 3, 1, 2)

    def tensors(self, rows: NDArray[np.intp],
                rng: np.random.Generator | None = None) -> tuple[dict[str, Tensor], Tensor]:
        """A batch as lerobot's policy takes it, normalised, and where cube and mark are; shifted if there is an rng."""
        found, s = self.data.gather(rows, self.deltas, Augment(SHIFT_PX) if rng else None, rng, "bytes"), self.scales
        batch = {
            self.shape.feature: self.pictures(found[self.shape.feature]),
            "observation.state": tensor((found["observation.state"] - s.state_mean) / s.state_std),
            "action": tensor((found["action"] - s.action_mean) / s.action_std),
            "action_is_pad": tensor(found["action_is_pad"]),
        }
        mean, std = self.hint_scale
        told = places(found["observation.state"], found["observation.environment_state"])
        return batch, tensor((told - mean) / std)

    def losses(self, batch: dict[str, Tensor], where: Tensor) -> tuple[Tensor, Tensor]:
        """lerobot's loss of the actions, and that of the hint."""
        policy: Any = self.policy
        loss: Tensor = policy.forward(batch)[0]
        assert self.features is not None
        return loss, F.smooth_l1_loss(self.head(self.features.flatten(1)), where)

    def update(self) -> None:
        """One step."""
        rng = np.random.default_rng((self.seed, TRAIN, self.course.step))
        loss, hint = self.losses(*self.tensors(self.data.draw(rng, self.config.batch), rng))
        (loss + HINT * hint).backward()  # pyright: ignore[reportUnknownMemberType]
        linalg: Any = torch.linalg
        gradient = self.course.optimiser.gradient
        length = float(linalg.vector_norm(gradient))
        if length > LONGEST_GRADIENT:
            gradient.mul_(LONGEST_GRADIENT / length)
        self.course.advance(loss.item())


def fit_act(data: PictureSource, config: TrainConfig, seed: int, *, resume_from: Path | None = None,
            checkpoints: Path | None = None, progress: Callable[[int, int, float], None] | None = None,
            threads: int = 1) -> FittedAct:
    """Train lerobot's ACT by behaviour cloning.

    Args:
        data: what to learn from, weights by source inside; it has pictures of one camera.
        config: steps, batch, learning rate; width and depth are the transformer's and its encoder's.
        seed: decides weights and batches; nothing else does.
        resume_from: a checkpoint of this same training, see pipeline.policies.resuming.newest.
        checkpoints: folder for resumable checkpoints, every `config.checkpoint_every` steps.
        progress: called as (steps done, steps in all, last training loss) every few steps.
        threads: of PyTorch; another number may give other bits.

    Raises:
        ConfigError: the version has no camera, or several.
        PolicyError: samples do not fit the robot, the checkpoint is of another training, or training diverges.
    """
    with deterministic(threads):
        trainer = _Trainer(data, config, seed)
        if resume_from is not None:
            trainer.course.resume(resume_from)
        while trainer.course.step < config.steps:
            trainer.update()
            if checkpoints is not None and trainer.course.step % config.checkpoint_every == 0:
                save_progress(checkpoints, trainer.course.identity, trainer.course.progress())
            if progress is not None and trainer.course.step % 10 == 0:
                progress(trainer.course.step, config.steps, trainer.course.last_loss)
        return FittedAct(trainer.shape, weights_of(trainer.policy), trainer.scales, tuple(trainer.course.train_loss),
                         tuple(trainer.course.held_out_loss))
