"""The nightly rule: what the scenes of tonight say at a level that leaves room for a whole year of nights.

Every array holds many nights side by side, so that the gate and the simulation of ten thousand years run the same
lines. See docs/decisions/016-a-gate-for-every-night.md.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, log

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from pipeline.statistics.betting import Counts, Reals, log_bound, log_gain, times_further

type Flags = NDArray[np.bool_]
type LogGain = Callable[[Counts, Counts], Reals]

HOPELESS = 0.05
"""A chance of being shown by the last scene below which a night is ended; giving up can never promote."""
SAME_AFTER = 200
"""Policies without one discordant scene among so many are not told apart tonight."""


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts of n nights, in which `families` are told apart."""

    fixed: Counts
    """Scenes only the candidate solves, shape (nights, families)."""
    broken: Counts
    """Scenes only the champion solves, the same shape."""
    scenes: Counts
    """Scenes played, the same shape."""

    def take(self, rows: Flags) -> "Tally":
        """Some of the nights."""
        return Tally(self.fixed[rows], self.broken[rows], self.scenes[rows])


@dataclass(frozen=True, slots=True)
class Limits:
    """What is asked of every night."""

    margin: float
    """Loss that no family may have."""
    alpha_fail: float
    """Error of FAIL, each night by itself: it promotes nobody, and pays for nothing."""
    most_scenes: int


@dataclass(frozen=True, slots=True)
class Rulings:
    """What the rule says of each night, shape (nights,)."""

    passed: Flags
    failed: Flags
    given_up: Flags


def rule_nights(tally: Tally, stakes: Reals, limits: Limits, gain: LogGain = log_gain) -> Rulings:
    """Decide at one moment of each night; it may be asked after every scene.

    PASS where the stake times the capital reaches 1 for the claim "no better on the whole mix" and for each claim
    "this family loses the margin or more". Somebody who is promoted wrongly makes one of the claims true, and all
    of them had to fall, so the chance is at most the stake however many families there are (Berger 1982).
    FAIL at a loss on the whole or in a family, each of these k questions at alpha_fail / k (Bonferroni). Given up where
    a PASS has become unlikely within most_scenes.

    Args:
        tally: counts so far.
        stakes: of each night, shape (nights,).
        limits: margin, error of FAIL and largest number of scenes.
        gain: log_gain, or a table of it.
    """
    fixed, broken, n = (x.sum(axis=1) for x in (tally.fixed, tally.broken, tally.scenes))
    needed = -np.log(stakes)
    shown = gain(fixed, broken) >= needed
    bounded = np.zeros_like(shown)
    near = np.flatnonzero(shown)
    capital = log_bound(tally.fixed[near], tally.broken[near], tally.scenes[near], limits.margin)
    bounded[near] = (capital >= needed[near, None]).all(axis=1)
    questions = 1 if tally.fixed.shape[1] == 1 else 1 + tally.fixed.shape[1]
    lost = gain(broken, fixed) >= log(questions / limits.alpha_fail)
    if questions > 1:
        lost |= (gain(tally.broken, tally.fixed) >= log(questions / limits.alpha_fail)).any(axis=1)
    passed = shown & bounded & ~lost
    dead = ~shown & _hopeless(fixed, broken, n, stakes, limits.most_scenes)
    dead |= _unbounded(tally, stakes, limits)
    return Rulings(passed, lost, dead & ~passed & ~lost)


def _hopeless(fixed: Counts, broken: Counts, n: Counts, stakes: Reals, most: int) -> Flags:
    """Whether a gain has little chance of being shown by the last scene, at the trend seen."""
    z = (fixed - broken) / np.sqrt(np.maximum(fixed + broken, 1))
    alike = (fixed + broken == 0) & (n >= SAME_AFTER)
    return np.asarray(alike | (outlooks(z, n / most, stakes) < HOPELESS))


def _unbounded(tally: Tally, stakes: Reals, limits: Limits) -> Flags:
    """Whether the loss of some family has little chance of being bounded by the last scene, at the trend seen."""
    discordant, n = tally.fixed + tally.broken, tally.scenes
    z = (limits.margin * n - (tally.broken - tally.fixed)) / np.sqrt(discordant + limits.margin**2 * n + 1e-9)
    seen = (n.sum(axis=1) / limits.most_scenes)[:, None]
    dead = (outlooks(z, seen, stakes[:, None]) < HOPELESS) & (n > 0)
    return np.asarray(dead.any(axis=1), np.bool_)


def outlooks(z: Reals, seen: Reals, alpha: Reals) -> Reals:
    """sequential.outlook for arrays: chance of significance at the last scene with a flat prior on the trend."""
    ahead = z + ndtri(alpha) * np.sqrt(seen)
    return ndtr(ahead / np.sqrt(np.maximum(1 - seen, 1e-12)))


def least_capital(tally: Tally, margin: float, gain: LogGain = log_gain) -> Reals:
    """The smallest capital of all claims of each night: what settles its stake, shape (nights,)."""
    whole = gain(tally.fixed.sum(axis=1), tally.broken.sum(axis=1))
    families = log_bound(tally.fixed, tally.broken, tally.scenes, margin)
    return np.exp(np.minimum(np.minimum(whole, families.min(axis=1)), 700.0))


def further_tonight(tally: Tally, stake: float, margin: float) -> int | None:
    """Further scenes of the mix after which a night would promote, at the rates seen; None where no number would do.

    Args:
        tally: of one night, shapes (1, families).
        stake: of the night.
        margin: loss that no family may have.
    """
    fixed, broken, n = (x[0].astype(np.float64) for x in (tally.fixed, tally.broken, tally.scenes))
    needed = -log(stake)

    def reached(times: float) -> bool:
        whole = log_gain(times * fixed.sum(), times * broken.sum())
        return bool(whole >= needed and (log_bound(times * fixed, times * broken, times * n, margin) >= needed).all())

    times = times_further(reached)
    return None if times is None else max(1, ceil((times - 1) * float(n.sum())))
