"""POLICIES: every kind of policy that a recipe may name.

A kind imports PyTorch when it is used, not when the table is read: whoever only names policies need not wait.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

from pipeline.consent import Consents
from pipeline.errors import unknown
from pipeline.policies.source import TrainingSource
from pipeline.protocols import Policy
from schemas.recipe import TrainConfig

if TYPE_CHECKING:
    from pipeline.lerobot_view.samples import Samples
    from pipeline.policies.act_training import FittedAct
    from pipeline.policies.training import Fitted
    from pipeline.ppo.fitting import FittedPpo, LessonFrom

type Progress = Callable[[int, int, float], None]
"""Called as (steps done, steps in all, last training loss)."""


class Fit(Protocol):
    """See pipeline.policies.training.fit."""

    def __call__(self, data: Any, config: TrainConfig, seed: int, *, resume_from: Path | None,
                 checkpoints: Path | None, progress: Progress | None) -> Any:
        """Train; the same arguments give the same weights."""
        ...


@dataclass(frozen=True, slots=True)
class PolicyKind:
    """How one kind of policy is trained and written, and how its released form is opened.

    What `load` gives is what `fit` takes, what `fit` gives is what `write` and `export` take.
    """

    load: Callable[[Path, Consents], Any]
    """Reads a dataset version's folder."""
    fit: Fit
    write: Callable[[Path, Any, TrainConfig], None]
    """Writes the lerobot checkpoint into a folder."""
    export: Callable[[Any, Path], float]
    """Writes the ONNX file; returns its largest difference to PyTorch in action units."""
    open: Callable[[Path], Policy]
    """Opens the ONNX file, without PyTorch."""
    sources: tuple[str, ...]
    """Files of pipeline/ that decide what is learnt: the training code that a policy id hashes."""
    sees: bool = False
    """Whether it needs pictures."""


def _load(folder: Path, consents: Consents) -> TrainingSource:
    from pipeline.lerobot_view.training_data import TrainingData

    return TrainingData.load(folder, consents)


def _fit(data: TrainingSource, config: TrainConfig, seed: int, *, resume_from: Path | None,
         checkpoints: Path | None, progress: Progress | None) -> "Fitted":
    from pipeline.policies.training import fit

    return fit(data, config, seed, resume_from=resume_from, checkpoints=checkpoints, progress=progress)


def _write(folder: Path, fitted: "Fitted", config: TrainConfig) -> None:
    from pipeline.policies.checkpoint import write_checkpoint

    write_checkpoint(folder, fitted, config)


def _export(fitted: "Fitted", path: Path) -> float:
    from pipeline.policies.export import export_onnx

    return export_onnx(fitted, path)


def _open(path: Path) -> Policy:
    from pipeline.policies.onnx_policy import OnnxPolicy

    return OnnxPolicy(path)


def _load_act(folder: Path, consents: Consents) -> "Samples":
    from pipeline.lerobot_view.samples import Samples

    return Samples.load(folder, consents)


def _fit_act(data: "Samples", config: TrainConfig, seed: int, *, resume_from: Path | None,
             checkpoints: Path | None, progress: Progress | None) -> "FittedAct":
    from pipeline.policies.act_training import fit_act

    return fit_act(data, config, seed, resume_from=resume_from, checkpoints=checkpoints, progress=progress)


def _write_act(folder: Path, fitted: "FittedAct", config: TrainConfig) -> None:
    from pipeline.policies.act_checkpoint import write_act

    write_act(folder, fitted, config)


def _export_act(fitted: "FittedAct", path: Path) -> float:
    from pipeline.policies.act_export import export_act

    return export_act(fitted, path)


def _open_act(path: Path) -> Policy:
    from pipeline.policies.act_onnx import ActOnnx

    return ActOnnx(path)


def _load_ppo(folder: Path, consents: Consents) -> "LessonFrom":
    from pipeline.locomotion.lesson import Lesson
    from pipeline.ppo.fitting import LessonFrom

    return LessonFrom(Lesson.load(folder, consents))


def _fit_ppo(data: "LessonFrom", config: TrainConfig, seed: int, *, resume_from: Path | None,
             checkpoints: Path | None, progress: Progress | None) -> "FittedPpo":
    from pipeline.ppo.fitting import fit_ppo

    return fit_ppo(data, config, seed, resume_from=resume_from, checkpoints=checkpoints, progress=progress)


def _write_ppo(folder: Path, fitted: "FittedPpo", config: TrainConfig) -> None:
    from pipeline.ppo.fitting import write_ppo

    write_ppo(folder, fitted, config)


def _export_ppo(fitted: "FittedPpo", path: Path) -> float:
    from pipeline.ppo.fitting import export_ppo

    return export_ppo(fitted, path)


def _open_ppo(path: Path) -> Policy:
    from pipeline.ppo.policy import LeggedPolicy

    return LeggedPolicy(path)


POLICIES: Mapping[str, PolicyKind] = MappingProxyType({
    "chunked": PolicyKind(_load, _fit, _write, _export, _open, (
        "frames.py", "lerobot_view/training_data.py", "policies/checkpoint.py", "policies/course.py",
        "policies/ensembling.py", "policies/export.py", "policies/features.py", "policies/network.py",
        "policies/optimiser.py", "policies/training.py")),
    "act": PolicyKind(_load_act, _fit_act, _write_act, _export_act, _open_act, (
        "footage.py", "frames.py", "lerobot_view/augmenting.py", "lerobot_view/frame_cache.py",
        "lerobot_view/frame_weights.py", "lerobot_view/samples.py", "lerobot_view/training_data.py",
        "policies/act_checkpoint.py", "policies/act_export.py", "policies/act_net.py", "policies/act_training.py",
        "policies/course.py", "policies/ensembling.py", "policies/export.py", "policies/network.py",
        "policies/optimiser.py", "policies/training.py"), sees=True),
    "ppo": PolicyKind(_load_ppo, _fit_ppo, _write_ppo, _export_ppo, _open_ppo, (
        "locomotion/attempts.py", "locomotion/biped.py", "locomotion/curriculum.py", "locomotion/delay.py",
        "locomotion/lesson.py", "locomotion/rewards.py", "locomotion/starts.py", "locomotion/tasks.py",
        "locomotion/varied.py", "locomotion/world.py", "ppo/checkpoint.py", "ppo/config.py", "ppo/export.py",
        "ppo/fitting.py", "ppo/model.py", "ppo/normaliser.py", "ppo/training.py", "ppo/vec_env.py", "ppo/weights.py")),
})


def policy_kind(name: str) -> PolicyKind:
    """The kind of that name.

    Raises:
        ConfigError: there is none; the message lists every name there is.
    """
    if name not in POLICIES:
        raise unknown("policy", name, POLICIES)
    return POLICIES[name]
