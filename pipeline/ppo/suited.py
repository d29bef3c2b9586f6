"""SUITED: numbers of trainings that one body needs otherwise than the task's."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pipeline.ppo.config import PpoConfig


@dataclass(frozen=True, slots=True)
class Suited:
    """What a training of one body on one task does in its own way."""

    ppo: PpoConfig
    """In place of the task's numbers in PPO_CONFIGS."""
    task: Mapping[str, float]
    """Fields of LeggedTask that the training sets otherwise; its policy is judged by them, too."""


SUITED: MappingProxyType[tuple[str, str], Suited] = MappingProxyType({
    # a robot of 51 kg that leans by .6 rad is lost: to call that a fall spares the ticks on its way to the ground
    ("stand", "unitree_h1"): Suited(PpoConfig(steps=8_000_000), {"fallen_rad": 0.6, "fallen_height": 0.75}),
})
"""Task and body, as on the command line -> what suits them. A task of a file is taken as it is."""
