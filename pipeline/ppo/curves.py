"""Curves of a training: what an iteration brought, one point an iteration, each reward term on its own."""

from collections.abc import Mapping
from math import isfinite
from types import MappingProxyType
from typing import Any, NotRequired, TypedDict

from pipeline.locomotion.attempts import Tick

UPDATE: Mapping[str, str] = MappingProxyType({
    "entropy": "train/entropy_loss", "kl": "train/approx_kl", "clipped": "train/clip_fraction",
    "explained": "train/explained_variance", "value_loss": "train/value_loss"})
"""Figure of an update -> SB3's name of it; SB3 has the entropy with the opposite sign."""


class Point(TypedDict):
    """One iteration."""

    step: int
    """Environment steps so far."""
    reward: float
    """Mean a tick."""
    terms: dict[str, float]
    """Reward term -> its weighted mean a tick."""
    fallen: int
    """Attempts that ended in a fall."""
    full: int
    """Attempts that reached their end."""
    length: float | None
    """Mean length of the attempts that ended [ticks]."""
    std: float
    """Mean standard deviation of the actions."""
    update: NotRequired[dict[str, float]]
    """Of the update that this iteration's samples gave: entropy of the actions [nat], KL divergence from the policy
    before it [nat], share of samples beyond the clip, share of the returns' variance that the critic explains, the
    critic's loss."""


class Tally:
    """Counts what happens until it is asked."""

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self._samples, self._fallen, self._full, self._ticks = 0, 0, 0, 0
        self._terms: dict[str, float] = {}

    def add(self, tick: Tick) -> None:
        """Another tick."""
        self._samples += len(tick.reward)
        self._fallen, self._full = self._fallen + int(tick.fallen.sum()), self._full + int(tick.late.sum())
        self._ticks += int(tick.length.sum())
        for name, values in tick.terms.items():
            self._terms[name] = self._terms.get(name, 0.0) + float(values.sum())

    def take(self, step: int, std: float) -> Point:
        """The point since the last call."""
        terms = {name: total / max(1, self._samples) for name, total in self._terms.items()}
        ended = self._fallen + self._full
        point = Point(step=step, reward=sum(terms.values()), terms=terms, fallen=self._fallen, full=self._full,
                      length=self._ticks / ended if ended else None, std=std)
        self._begin()
        return point


def update_figures(logged: Mapping[str, Any]) -> dict[str, float]:
    """What PPO says of its last update, out of SB3's log; what is missing or not finite is left out."""
    found = {name: float(logged[key]) for name, key in UPDATE.items() if key in logged and isfinite(float(logged[key]))}
    return found | {"entropy": -found["entropy"]} if "entropy" in found else found
