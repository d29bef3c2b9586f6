"""An error budget over many nights: what a night may stake, and what it gives back.

The budget is money that pays for false promotions, 1 each. A night stakes part of it and bets the stake against the
claim that its candidate is no better; it promotes when stake times capital reaches 1, which is what it then pays.
What is left of the stake comes back. While the claim is true every bet is fair, so
money plus false promotions cannot grow on average: their expected number is at most the budget. No independence of
nights is asked for, and stakes may follow from everything seen before. The proof:
docs/decisions/016-a-gate-for-every-night.md.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import GateError

type Reals = NDArray[np.float64]
type Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Purse:
    """The money of one budget year."""

    since: int
    """First day of the year, as a day number [d]."""
    money: float
    """Expected false promotions that may still be paid for."""


def carried(purse: Purse | None, day: int, *, budget: float, days: int) -> Purse:
    """The purse on a day: the one before, or a full one on the first day of a budget year; nothing is saved up.

    Args:
        purse: after the night before, None before the first.
        day: number of the day, only its differences matter [d].
        budget: money of a whole year.
        days: length of a budget year [d].

    Raises:
        GateError: the day lies before the budget year of the night before.
    """
    if purse is None:
        return Purse(day, budget)
    if day < purse.since:
        raise GateError(f"day {day} lies before the budget year that began on day {purse.since}", where="night's day",
                        mend="set the clock right, or name a later day: hardcase night --day N")
    years = (day - purse.since) // days
    return purse if years == 0 else Purse(purse.since + years * days, budget)


def stake(purse: Purse, day: int, *, budget: float, days: int, most: float, every: int = 1) -> float:
    """What a night may lose: an equal part of the money for each chance left in the year, and no windfall at its end.

    Args:
        purse: as of this day.
        day: number of the day [d].
        budget, days: as above; their ratio is the even part of a night.
        most: largest stake, in even parts.
        every: chances come at most every so many days [d].
    """
    left = max(1, -(-(purse.since + days - day) // every))
    return min(purse.money / left, most * budget * every / days)


def settled(purse: Purse, staked: float, *, promoted: bool, capital: float) -> Purse:
    """The purse after a night.

    Without a promotion the stake times the capital is left of it. A promotion pays 1, so what is left is the stake
    times the capital less 1. More than the stake never comes back: a night with a truly better candidate must not make
    money for others.

    Args:
        purse: before the night.
        staked: its stake.
        promoted: whether the candidate was promoted.
        capital: the smallest capital of all claims that a promotion has to refute. Whichever of them was true, its
            bets were fair.
    """
    return Purse(purse.since, purse.money - staked + float(given_back(np.float64(staked), promoted, capital)))


def given_back(staked: Reals | float, promoted: Flags | bool, capital: Reals | float) -> Reals:
    """What comes back of a stake; arrays of nights side by side, any shape."""
    return np.clip(staked * np.asarray(capital) - np.asarray(promoted, np.float64), 0, staked)
