"""Years of nights, simulated: how many false promotions the budget really lets through, and how soon it sees gains."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.statistics.betting import Counts, Reals, log_gain
from pipeline.statistics.budget import given_back
from pipeline.statistics.nightly import Flags, Limits, LogGain, Tally, least_capital, rule_nights

type Chances = NDArray[np.float64]
TABLE = 700
"""Counts up to which the capital is looked up instead of computed."""


@dataclass(frozen=True, slots=True)
class Tonight:
    """The truth of one night, of many nights side by side."""

    chances: Chances
    """Chance of each outcome of a scene: of each family in turn fixed, broken, neither; shape (nights, 3 families)."""
    false: Flags
    """Whether a promotion would be false, shape (nights,)."""
    before: Tally | None = None
    """Scenes that the test counts although they chose the candidate: what must not be done."""


type World = Callable[[np.random.Generator, int, int], Tonight]
"""(random numbers, nights side by side, number of the night) -> the truth."""


@dataclass(frozen=True, slots=True)
class Played:
    """What became of many nights."""

    promoted: Flags
    failed: Flags
    scenes: Counts
    """Scenes that each night played."""
    capital: Reals
    """The smallest capital of each night's claims at its end."""


@dataclass(frozen=True, slots=True)
class Years:
    """What became of many years."""

    false: Counts
    """False promotions of each year, shape (years,)."""
    true: Counts
    """True ones."""
    scenes: float
    """Scenes a night, on average."""
    money: Reals
    """Money left at the end of each year."""
    largest: float
    """Largest stake of any night."""


def pair(champion: Reals | float, candidate: Reals | float, shared: Reals | float) -> tuple[Reals, Reals]:
    """Chances that a scene is fixed and that it is broken, for two success rates and the correlation of outcomes."""
    spread = np.sqrt(champion * (1 - champion) * candidate * (1 - candidate))
    both = np.minimum(np.minimum(champion * candidate + shared * spread, champion), candidate)
    return candidate - both, champion - both


def mixed(shares: Reals, fixed: Reals, broken: Reals) -> Chances:
    """Chances of the outcomes of a scene of a mix, from those within its families; shapes (..., f) -> (..., 3 f)."""
    parts = np.stack([shares * fixed, shares * broken, shares * (1 - fixed - broken)], axis=-1)
    return np.maximum(parts, 0).reshape(*parts.shape[:-2], -1)


def table(size: int = TABLE) -> LogGain:
    """log_gain by looking it up, for counts below `size`."""
    counts = np.arange(size)
    known = log_gain(counts[:, None], counts[None, :])

    def gain(fixed: Counts, broken: Counts) -> Reals:
        if max(fixed.max(initial=0), broken.max(initial=0)) >= size:
            return log_gain(fixed, broken)
        return known[fixed, broken]

    return gain


def play(truth: Tonight, stakes: Reals, limits: Limits, batch: int, rng: np.random.Generator, gain: LogGain) -> Played:
    """Let many nights run side by side, each until the rule has decided or its scenes are spent."""
    nights, families = truth.chances.shape[0], truth.chances.shape[1] // 3
    seen = np.zeros((nights, 3 * families), np.int64)
    if truth.before is not None:
        seen = np.stack([truth.before.fixed, truth.before.broken,
                         truth.before.scenes - truth.before.fixed - truth.before.broken], -1).reshape(nights, -1)
    promoted, failed = np.zeros(nights, np.bool_), np.zeros(nights, np.bool_)
    scenes, open_ = np.zeros(nights, np.int64), np.arange(nights)
    for played in range(batch, limits.most_scenes + batch, batch):
        seen[open_] += rng.multinomial(batch, truth.chances[open_])
        ruling = rule_nights(_tally(seen[open_]), stakes[open_], limits, gain)
        promoted[open_], failed[open_], scenes[open_] = ruling.passed, ruling.failed, played
        open_ = open_[~(ruling.passed | ruling.failed | ruling.given_up)]
        if not open_.size:
            break
    return Played(promoted, failed, scenes, least_capital(_tally(seen), limits.margin, gain))


def live(world: World, *, years: int, nights: int, budget: float, most_stake: float, limits: Limits, batch: int,
         seed: int, gives_back: bool = True, told: Callable[[int], None] = lambda _: None) -> Years:
    """Live through many years side by side, each with a purse of its own.

    Args:
        world: the truth of each night.
        years: how many.
        nights: of a year.
        budget: of a year, for the test of tonight's candidate.
        most_stake: largest stake in even parts.
        limits, batch: of each night.
        seed: of all random numbers.
        gives_back: whether nights take back what is left of their stake; else each stakes its even part.
        told: called with the number of each finished night.
    """
    rng, gain = np.random.default_rng(seed), table()
    money, false, true = np.full(years, budget), np.zeros(years, np.int64), np.zeros(years, np.int64)
    scenes, largest, even = 0.0, 0.0, budget / nights
    for night in range(nights):
        stakes = np.minimum(money / (nights - night), most_stake * even) if gives_back else np.full(years, even)
        truth = world(rng, years, night)
        done = play(truth, np.maximum(stakes, 1e-12), limits, batch, rng, gain)
        money -= stakes - (given_back(stakes, done.promoted, done.capital) if gives_back else 0.0)
        false += done.promoted & truth.false
        true += done.promoted & ~truth.false
        scenes += done.scenes.mean() / nights
        largest = max(largest, float(stakes.max()))
        told(night + 1)
    return Years(false, true, scenes, money, largest)


def _tally(seen: Counts) -> Tally:
    parts = seen.reshape(seen.shape[0], -1, 3)
    return Tally(parts[:, :, 0], parts[:, :, 1], parts.sum(axis=2))
