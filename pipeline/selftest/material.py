"""Material: the clean recordings and datasets that faults are planted in, and what was expected of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from schemas.contract import Contract
from schemas.finding import Finding

type Kind = Literal["demonstrated", "succeeded", "failed", "coarse", "corrected", "filmed", "dataset", "film dataset"]
"""Scripted successes; attempts of a policy on a twin that succeeded or failed; attempts read through coarse encoders;
failures that were corrected; demonstrations with two cameras; dataset versions; datasets with two cameras."""

REFUSED = "refused"
"""What stands for a check where a file or folder cannot be read at all, and is named with the reason."""


@dataclass(frozen=True, slots=True)
class Material:
    """Clean recordings and datasets by kind, with the contract that each kind is held against."""

    clean: Mapping[Kind, tuple[Path, ...]]
    contracts: Mapping[Kind, Contract]
    rendered: bool
    """Whether the cameras' pictures were rendered; drawn where nothing renders."""

    @property
    def episodes(self) -> int:
        """Clean recordings in all."""
        return sum(len(paths) for kind, paths in self.clean.items() if "dataset" not in kind)


@dataclass(frozen=True, slots=True)
class Site:
    """Where one fault is planted."""

    clean: Path
    """The recording or dataset without it; never changed."""
    out: Path
    """The recording or dataset with it."""
    rng: np.random.Generator
    """For where and how much."""


class Fault(NamedTuple):
    """A fault that users suffer from, and the checks that are meant for it."""

    what: str
    on: Kind
    plant: Callable[[Site], None]
    expect: tuple[str, ...]
    """Any one of these checks will do."""
    beside: bool = False
    """It shows only beside the recording that it was planted in."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What the checks said of one file or folder."""

    findings: tuple[Finding, ...]
    refused: str = ""
    """Why it could not be read at all."""

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that keep it out of training."""
        return tuple(f for f in self.findings if f.severity == "error")


type Judge = Callable[[Sequence[Path], Contract], Sequence[Seen]]
"""The checks over items one after the other, as `hardcase check` does it."""
