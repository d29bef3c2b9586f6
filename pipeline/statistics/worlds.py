"""Worlds to live many years in: candidates that are no better than the champion, in every way that a night may meet."""

from types import MappingProxyType

import numpy as np

from pipeline.statistics.betting import Counts, Reals
from pipeline.statistics.nightly import Tally
from pipeline.statistics.nights import Chances, Tonight, World, mixed, pair

CHAMPION = 0.85
SHARED = 0.3
"""Correlation of the outcomes of two policies on a scene, where nothing else is said."""
SEEDS, SEED_SD = 5, 0.02
"""Trainings a candidate, and how far apart their true success rates are."""
SELECTION = 200
SHARES = np.array([0.5, 0.25, 0.25])
"""Families of the worlds that have several."""
MARGIN = 0.05


def equal(shared: float) -> World:
    """Every candidate is as good as the champion."""
    chances = _one(CHAMPION, CHAMPION, shared)
    return lambda rng, n, night: Tonight(np.broadcast_to(chances, (n, 3)), np.ones(n, np.bool_))


def best_of_seeds(rng: np.random.Generator, n: int, night: int) -> Tonight:
    """Trainings differ by luck; the best on selection scenes is judged on fresh ones. False if it is no better."""
    rates = np.clip(CHAMPION + rng.normal(0, SEED_SD, (n, SEEDS)), 0.01, 0.99)
    chosen = np.take_along_axis(rates, rng.binomial(SELECTION, rates).argmax(axis=1)[:, None], axis=1)[:, 0]
    fixed, broken = pair(CHAMPION, chosen, SHARED)
    return Tonight(mixed(np.ones(1), fixed[:, None], broken[:, None]), chosen <= CHAMPION)


def reused_scenes(rng: np.random.Generator, n: int, night: int) -> Tonight:
    """What must not be done: equal trainings, and the scenes that chose among them count in the test."""
    chances = _one(CHAMPION, CHAMPION, SHARED)
    seen: Counts = rng.multinomial(SELECTION, np.broadcast_to(chances, (n, SEEDS, 3)))
    best = (seen[:, :, 0] - seen[:, :, 1]).argmax(axis=1)
    chosen = seen[np.arange(n), best]
    before = Tally(chosen[:, :1], chosen[:, 1:2], chosen.sum(axis=1)[:, None])
    return Tonight(np.broadcast_to(chances, (n, 3)), np.ones(n, np.bool_), before)


def drifting(rng: np.random.Generator, n: int, night: int) -> Tonight:
    """Equal on the mix, but mix, success and agreement drift from night to night, and families gain and lose."""
    season = 0.1 * np.sin(2 * np.pi * night / 365)
    shares = rng.dirichlet(8 * SHARES, n)
    champion = np.clip(rng.uniform(0.5, 0.95, (n, 3)) + season, 0.05, 0.97)
    change = rng.uniform(-MARGIN, MARGIN, (n, 3))
    change -= (shares * change).sum(axis=1)[:, None]
    candidate = np.clip(champion + np.minimum(change, 0.97 - champion), 0.01, 0.99)
    fixed, broken = pair(champion, candidate, rng.uniform(0, 0.9, (n, 1)))
    better = (shares * (candidate - champion)).sum(axis=1) > 1e-9
    return Tonight(mixed(shares, fixed, broken), ~better)


def one_family_loses(rng: np.random.Generator, n: int, night: int) -> Tonight:
    """Better on the mix by 6 points, while one family loses just the margin."""
    champion = np.array([0.8, 0.85, 0.85])
    fixed, broken = pair(champion, champion + np.array([0.10, 0.10, -MARGIN]), SHARED)
    return Tonight(np.broadcast_to(mixed(SHARES, fixed, broken), (n, 9)), np.ones(n, np.bool_))


def every_other_night(rng: np.random.Generator, n: int, night: int) -> Tonight:
    """One night a candidate that is 5 points better, one night an equal one: true gains must not pay for others."""
    better = night % 2 == 0
    chances = _one(CHAMPION, CHAMPION + 0.05 * better, SHARED)
    return Tonight(np.broadcast_to(chances, (n, 3)), np.full(n, not better))


def _one(champion: Reals | float, candidate: Reals | float, shared: float) -> Chances:
    fixed, broken = pair(champion, candidate, shared)
    return mixed(np.ones(1), np.atleast_1d(fixed), np.atleast_1d(broken))


WORLDS: MappingProxyType[str, World] = MappingProxyType({
    "equal": equal(SHARED),
    "equal, outcomes independent": equal(0.0),
    "equal, outcomes correlate by .8": equal(0.8),
    "best of 5 trainings": best_of_seeds,
    "drifting nulls, three families": drifting,
    "one of three families loses the margin": one_family_loses,
    "every other candidate 5 points better": every_other_night,
    "not to be done: selection scenes in the test": reused_scenes,
})
"""Name -> world; a promotion that its Tonight calls false counts."""
