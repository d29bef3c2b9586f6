"""The error budget of a year: what nights may stake, what comes back, and how many false promotions it lets through."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import GateError
from pipeline.statistics.budget import Purse, carried, given_back, settled, stake
from pipeline.statistics.nightly import Limits, Tally, least_capital, rule_nights
from pipeline.statistics.nights import Tonight, live, mixed
from pipeline.statistics.worlds import WORLDS

YEAR = {"budget": 0.1, "days": 365}


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 3), st.booleans(), st.floats(0, 50)), max_size=400))
def test_no_year_ever_stakes_more_than_it_has(nights):
    purse, day, spent = Purse(7, 0.1), 7, 0.0
    for later, promoted, capital in nights:
        day = min(day + later, 7 + 364)
        staked = stake(purse, day, **YEAR, most=4)
        assert 0 <= staked <= min(purse.money, 4 * 0.1 / 365) + 1e-15
        after = settled(purse, staked, promoted=promoted, capital=1 / max(staked, 1e-12) if promoted else capital)
        assert purse.money - staked - 1e-15 <= after.money <= purse.money + 1e-15, "nothing is earned"
        spent, purse = spent + purse.money - after.money, after
    assert spent <= 0.1 + 1e-12


def test_nights_that_ask_nothing_leave_their_part_to_the_others():
    purse = Purse(0, 0.1)
    assert stake(purse, 0, **YEAR, most=4) == pytest.approx(0.1 / 365)
    assert stake(purse, 182, **YEAR, most=4) == pytest.approx(0.1 / 183)
    assert stake(purse, 364, **YEAR, most=4) == pytest.approx(4 * 0.1 / 365), "no windfall on the last night"
    assert stake(purse, 0, **YEAR, most=4, every=10) == pytest.approx(0.1 / 37)


def test_a_new_year_begins_with_a_full_purse_and_saves_nothing():
    old = Purse(100, 0.02)
    assert carried(old, 464, **YEAR) == old
    assert carried(old, 465, **YEAR) == Purse(465, 0.1)
    assert carried(old, 100 + 3 * 365 + 5, **YEAR) == Purse(100 + 3 * 365, 0.1)
    assert carried(None, 5, **YEAR) == Purse(5, 0.1)


def test_a_day_before_the_year_is_refused_with_the_mend():
    with pytest.raises(GateError, match="mend: set the clock right, or name a later day: hardcase night --day N"):
        carried(Purse(100, 0.1), 99, **YEAR)


def exact_night(staked: float, chances: tuple[float, float], limits: Limits, batch: int) -> tuple[float, float]:
    """Chance of a promotion and mean money that comes back of one night, by adding up every path of the rule."""
    states, promoted, back = {(0, 0): 1.0}, 0.0, 0.0
    scene = {(1, 0): chances[0], (0, 1): chances[1], (0, 0): 1 - sum(chances)}
    for n in range(1, limits.most_scenes + 1):
        grown: dict[tuple[int, int], float] = {}
        for (f, b), p in states.items():
            for (df, db), q in scene.items():
                grown[f + df, b + db] = grown.get((f + df, b + db), 0.0) + p * q
        states = grown
        if n % batch:
            continue
        keys, weight = list(states), np.array(list(states.values()))
        tally = Tally(np.array([[f] for f, _ in keys]), np.array([[b] for _, b in keys]), np.full((len(keys), 1), n))
        ruling = rule_nights(tally, np.full(len(keys), staked), limits)
        over = ruling.passed | ruling.failed | ruling.given_up | (n == limits.most_scenes)
        promoted += weight[ruling.passed].sum()
        returned = given_back(np.full(len(keys), staked), ruling.passed, least_capital(tally, limits.margin))
        back += (weight * returned)[over].sum()
        states = {k: p for k, p, done in zip(keys, weight, over, strict=True) if not done}
    return promoted, back


@pytest.mark.parametrize("chances", [(0.15, 0.15), (0.02, 0.02), (0.1, 0.2), (0.5, 0.5)], ids=str)
@pytest.mark.parametrize("staked", [0.2, 0.01])
def test_a_night_without_a_better_candidate_pays_for_its_false_promotions(chances, staked):
    promoted, back = exact_night(staked, chances, Limits(0.2, 0.05, 100), 10)
    assert promoted + back <= staked + 1e-12, "money plus false promotions do not grow on average"
    assert promoted <= staked


def test_a_family_that_loses_the_margin_pays_as_well():
    limits = Limits(0.1, 0.05, 100)
    promoted, back = exact_night(0.1, (0.05, 0.15), limits, 10)
    assert promoted + back <= 0.1 + 1e-12


@pytest.mark.parametrize("name", [n for n in WORLDS if not n.startswith("not to be done")])
def test_years_of_nights_keep_to_the_budget(name):
    years = live(WORLDS[name], years=1500, nights=12, budget=0.3, most_stake=4, limits=Limits(0.05, 0.05, 600),
                 batch=50, seed=3)
    assert years.false.mean() <= 0.3 + 1e-9
    assert years.money.min() >= 0
    assert years.largest <= 4 * 0.3 / 12 + 1e-12


def test_scenes_that_chose_a_candidate_must_not_judge_it():
    numbers = {"years": 1500, "nights": 12, "budget": 0.3, "most_stake": 4, "limits": Limits(0.05, 0.05, 600),
               "batch": 50, "seed": 3}
    reused = live(WORLDS["not to be done: selection scenes in the test"], **numbers)
    assert reused.false.mean() > 2 * live(WORLDS["equal"], **numbers).false.mean()


def test_true_gains_are_promoted_and_cost_the_others_nothing():
    chances = mixed(np.ones(1), np.array([0.15]), np.array([0.03]))
    years = live(lambda rng, n, night: Tonight(np.broadcast_to(chances, (n, 3)), np.zeros(n, bool)), years=200,
                 nights=10, budget=0.1, most_stake=4, limits=Limits(0.05, 0.05, 1000), batch=50, seed=1)
    assert years.true.mean() > 9.9 and years.false.sum() == 0
    assert years.money.mean() > 0.08, "a promotion with more evidence than it needs takes its stake back"
