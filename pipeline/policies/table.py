"""POLICIES: every kind of policy that a recipe may name.

A kind imports PyTorch when it is used, not when the table is read: whoever only names policies need not wait.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

from pipeline.errors import unknown
from pipeline.policies.source import TrainingSource
from schemas.recipe import TrainConfig

if TYPE_CHECKING:
    from pipeline.policies.training import Fitted

type Progress = Callable[[int, int, float], None]
"""Called as (steps done, steps in all, last training loss)."""


class Fit(Protocol):
    """See pipeline.policies.training.fit."""

    def __call__(self, data: TrainingSource, config: TrainConfig, seed: int, *, resume_from: Path | None,
                 checkpoints: Path | None, progress: Progress | None) -> "Fitted":
        """Train; the same arguments give the same weights."""
        ...


@dataclass(frozen=True, slots=True)
class PolicyKind:
    """How one kind of policy is trained and written."""

    fit: Fit
    write: Callable[[Path, "Fitted", TrainConfig], None]
    """Writes the lerobot checkpoint into a folder."""
    export: Callable[["Fitted", Path], float]
    """Writes the ONNX file; returns its largest difference to PyTorch in action units."""
    sources: tuple[str, ...]
    """Files of pipeline/ that decide what is learnt: the training code that a policy id hashes."""


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


POLICIES: Mapping[str, PolicyKind] = MappingProxyType({
    "chunked": PolicyKind(_fit, _write, _export, (
        "frames.py", "lerobot_view/training_data.py", "policies/checkpoint.py", "policies/ensembling.py",
        "policies/export.py", "policies/features.py", "policies/network.py", "policies/optimiser.py",
        "policies/training.py")),
})


def policy_kind(name: str) -> PolicyKind:
    """The kind of that name.

    Raises:
        ConfigError: there is none; the message lists every name there is.
    """
    if name not in POLICIES:
        raise unknown("policy", name, POLICIES)
    return POLICIES[name]
