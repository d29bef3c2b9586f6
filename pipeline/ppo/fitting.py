"""Fitting: PPO as the loop trains it, out of a lesson and a recipe's numbers, into a policy's folder."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from pipeline.documents import from_values
from pipeline.errors import PolicyError
from pipeline.files import atomic, sha256_file
from pipeline.locomotion.lesson import Lesson
from pipeline.ppo.config import PPO_CONFIGS, Order, PpoConfig
from pipeline.ppo.curves import Point
from pipeline.ppo.training import Training
from schemas.recipe import TrainConfig

WEIGHTS, CURVE = "weights.safetensors", "training.json"
"""What a policy's folder holds beside the ONNX file: what a later training goes on from, and the curves."""


@dataclass(frozen=True, slots=True)
class LessonFrom:
    """A lesson, and where the weights lie that a training of it goes on from."""

    lesson: Lesson
    champion: Path | None = None
    """Folder of a policy; None where a training begins at random weights."""


@dataclass(frozen=True, slots=True)
class FittedPpo:
    """A finished training; see stages.train."""

    training: Training
    train_loss: tuple[tuple[int, float], ...] = ()
    """Empty: PPO has no loss that would tell how good it is; its curves are in training.json."""
    held_out_loss: tuple[tuple[int, float], ...] = ()

    @property
    def weights(self) -> Mapping[str, NDArray[Any]]:
        """Of actor and critic."""
        return self.training.weights


def order_for(data: LessonFrom, config: TrainConfig, seed: int) -> Order:
    """What is ordered of PPO: the task's tuned numbers, and in their place what the recipe names.

    Raises:
        ConfigError: a number that PPO cannot use.
        PolicyError: a policy is to go on from another and is not told where that lies.
    """
    if (config.goes_on is None) != (data.champion is None):
        raise PolicyError("a training goes on from a policy exactly where its config names one",
                          where=f"train.goes_on: {config.goes_on}", mend="let the loop name it: hardcase train")
    lesson = data.lesson
    named = {} if config.ppo is None else config.ppo.model_dump(exclude_none=True)
    numbers = PPO_CONFIGS.get(lesson.name, PpoConfig()).model_dump() | {
        "steps": config.steps, "batch": config.batch, "learning_rate": config.learning_rate, **named}
    ppo = from_values(numbers, PpoConfig, where="recipe: train", example="fields: pipeline/ppo/config.py")
    begins = None if data.champion is None else sha256_file(data.champion / WEIGHTS)
    return Order(body=lesson.body, name=lesson.name, task=lesson.task, curriculum=lesson.curriculum,
                 vary=lesson.vary, goes_on=begins, ppo=ppo, seed=seed)


def fit_ppo(data: LessonFrom, config: TrainConfig, seed: int, *, resume_from: Path | None = None,
            checkpoints: Path | None = None, progress: Callable[[int, int, float], None] | None = None) -> FittedPpo:
    """Train; the same lesson, config, weights to go on from and seed give the same weights, cut off or not.

    Args:
        data: where attempts begin, and with which weights.
        config: steps, batch, learning rate and the other numbers of PPO.
        seed: of starts, weights and draws.
        resume_from: where a checkpoint was found; a training goes on from the newest one in `checkpoints`.
        checkpoints: folder of the checkpoints.
        progress: called as (ticks done, ticks in all, mean reward a tick).
    """
    del resume_from
    if checkpoints is None:
        raise PolicyError("a training needs a folder for its checkpoints", where="policy ppo",
                          mend="train in a store: hardcase train")
    order = order_for(data, config, seed)
    training = Training(order, checkpoints, weights=None if data.champion is None else data.champion / WEIGHTS)

    def told(point: Point, total: int) -> None:
        if progress is not None:
            progress(min(point["step"], total), total, point["reward"])

    training.run(told, save_every=max(1, config.checkpoint_every // order.ppo.iteration))
    return FittedPpo(training)


def write_ppo(folder: Path, fitted: FittedPpo, config: TrainConfig) -> None:
    """Write into a policy's folder what a later training goes on from, and the curves of this one."""
    del config
    training = fitted.training
    training.leave_weights(folder / WEIGHTS)
    with atomic(folder / CURVE) as stream:
        told = {"id": training.order.id, "ppo": training.order.ppo.model_dump(mode="json"), "curve": training.curve}
        stream.write(json.dumps(told).encode() + b"\n")


def export_ppo(fitted: FittedPpo, path: Path) -> float:
    """Write the ONNX file; returns its largest difference to PyTorch, in shares."""
    return fitted.training.export(path)
