"""What the gate promises and how often it answers, by simulation. Run: python -m pytest -s tests/bench_gate.py

Two policies of known success rates play interleaved strata; their outcomes on a scene correlate by `shared`, because
hard scenes are hard for both (0 is the worst case). Prints how often the gate says PASS by each look, how often FAIL,
and how many scenes it plays on average. Fixed seeds; about five minutes on one core.
"""

import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from pipeline.statistics import loss_upper, spend
from pipeline.statistics.nightly import Limits, Tally, rule_nights
from pipeline.statistics.nights import mixed, pair
from pipeline.statistics.power import fixed_size, nightly_operating
from pipeline.statistics.promotion import compare_strata, rule
from schemas.recipe import GateConfig

COMMON = (0.95, 0.95)
HALVES = {"common": 0.7, "side": 0.15, "large": 0.15}


@dataclass(frozen=True)
class Case:
    """Success (champion, candidate) by stratum."""

    name: str
    rates: dict[str, tuple[float, float]]
    shared: float = 0.3
    shares: dict[str, float] = field(default_factory=lambda: {"common": 0.7, "side": 0.3})
    config: GateConfig = field(default_factory=lambda: GateConfig(looks=(200, 400, 800), rare_share=0.3))
    limit: float | None = None
    """Largest allowed share of PASS, where a PASS would be false."""
    by_400: float | None = None
    """Smallest share of PASS by 400 scenes, where the loop depends on it."""


CASES = (
    Case("equal, .95/.70", {"common": COMMON, "side": (0.7, 0.7)}, limit=0.05),
    Case("equal, .95/.70, nothing shared", {"common": COMMON, "side": (0.7, 0.7)}, shared=0, limit=0.05),
    Case("equal, .75/.75, nothing shared", {"common": (0.75, 0.75), "side": (0.75, 0.75)}, shared=0, limit=0.05),
    Case("equal, three strata", {"common": COMMON, "side": (0.7, 0.7), "large": (0.5, 0.5)}, shares=HALVES, limit=0.05),
    Case("rare 0 to .7, common loses 5", {"common": (0.95, 0.9), "side": (0, 0.7)}, limit=0.05),
    Case("rare 0 to .7, common loses 5, nothing shared", {"common": (0.95, 0.9), "side": (0, 0.7)}, 0, limit=0.05),
    Case("+5 everywhere from .75", {"common": (0.75, 0.8), "side": (0.75, 0.8)}),
    Case("+10 everywhere from .75", {"common": (0.75, 0.85), "side": (0.75, 0.85)}),
    Case("+20 everywhere from .75", {"common": (0.75, 0.95), "side": (0.75, 0.95)}),
    Case("first lap: rare 0 to .7, common .95 stays", {"common": COMMON, "side": (0, 0.7)}, by_400=0.7),
    Case("same, nothing shared", {"common": COMMON, "side": (0, 0.7)}, shared=0, by_400=0.55),
    Case("same, common .93 to .95", {"common": (0.93, 0.95), "side": (0, 0.7)}, by_400=0.9),
    Case("same, common .93 to .97", {"common": (0.93, 0.97), "side": (0, 0.7)}, by_400=0.97),
    Case("first lap, rare_share .2", {"common": COMMON, "side": (0, 0.7)}, shares={"common": 0.8, "side": 0.2}),
    Case("first lap, rare_share .5", {"common": COMMON, "side": (0, 0.7)}, shares={"common": 0.5, "side": 0.5}),
    Case("first lap, looks 200 400", {"common": COMMON, "side": (0, 0.7)},
         config=GateConfig(looks=(200, 400), rare_share=0.3)),
    Case("later lap: rare .7 to .82", {"common": (0.95, 0.96), "side": (0.7, 0.82)}),
    Case("second rare kind at 0", {"common": (0.93, 0.95), "side": (0, 0.7), "large": (0, 0)}, shares=HALVES),
    Case("second rare kind 0 to .3", {"common": (0.93, 0.95), "side": (0, 0.7), "large": (0, 0.3)}, shares=HALVES),
    Case("second rare kind stays .5", {"common": (0.93, 0.95), "side": (0, 0.7), "large": (0.5, 0.5)}, shares=HALVES),
    Case("second rare kind stays .9", {"common": (0.93, 0.95), "side": (0, 0.7), "large": (0.9, 0.9)}, shares=HALVES),
    Case("second stays .5, margin .15", {"common": (0.93, 0.95), "side": (0, 0.7), "large": (0.5, 0.5)}, shares=HALVES,
         config=GateConfig(looks=(200, 400, 800), rare_share=0.3, margin=0.15)),
    Case("worse: common .95 to .85", {"common": (0.95, 0.85), "side": (0.7, 0.7)}),
)


def sequence(shares: dict[str, float], n: int) -> np.ndarray:
    """Strata interleaved so that every prefix holds its shares."""
    owed, labels = dict.fromkeys(shares, 0.0), []
    for _ in range(n):
        owed = {s: owed[s] + share for s, share in shares.items()}
        labels.append(max(owed, key=lambda s: owed[s]))
        owed[labels[-1]] -= 1
    return np.array(labels)


def outcomes(rng: np.random.Generator, labels: np.ndarray, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Candidate and champion on every scene, with the rates of the case and correlation `shared`."""
    candidate, champion = np.zeros(labels.size, bool), np.zeros(labels.size, bool)
    for stratum, (old, new) in case.rates.items():
        both = old * new + case.shared * np.sqrt(old * (1 - old) * new * (1 - new))
        both = min(both, old, new)
        u, mask = rng.random(int((labels == stratum).sum())), labels == stratum
        champion[mask] = u < old
        candidate[mask] = (u < both) | ((u >= old) & (u < old + new - both))
    return candidate, champion


def play(case: Case, repeats: int) -> dict[str, float]:
    """Shares of each decision over many gates, and mean scenes."""
    rng, config = np.random.default_rng(11), case.config
    labels, alphas = sequence(case.shares, config.looks[-1]), spend(config.looks, config.alpha)
    found = {"FAIL": 0.0, "scenes": 0.0} | {str(n): 0.0 for n in config.looks}
    for _ in range(repeats):
        candidate, champion = outcomes(rng, labels, case)
        for look, (n, alpha) in enumerate(zip(config.looks, alphas, strict=True)):
            ruling = rule(compare_strata(list(labels[:n]), candidate[:n], champion[:n], alpha), config, look)
            if ruling.decision != "continue":
                break
        found["scenes"] += n / repeats
        if ruling.decision == "FAIL":
            found["FAIL"] += 1 / repeats
        for later in config.looks:
            found[str(later)] += (ruling.decision == "PASS" and n <= later) / repeats
    return found


@pytest.mark.timeout(1800)
def test_operating_characteristics(capsys):
    with capsys.disabled():
        print(f"\n{'case':<46}{'PASS by 200':>12}{'by 400':>8}{'in all':>8}{'FAIL':>7}{'scenes':>8}")
        for case in CASES:
            found = play(case, 500 if case.limit is None else 1000)
            total = found[str(case.config.looks[-1])]
            print(f"{case.name:<46}{found['200']:12.3f}{found['400']:8.3f}{total:8.3f}{found['FAIL']:7.3f}"
                  f"{found['scenes']:8.0f}", flush=True)
            if case.limit is not None:
                assert total <= case.limit, "false promotions are rarer than alpha"
            if case.by_400 is not None:
                assert found["400"] >= case.by_400, "a lap that learnt passes without spending the budget"


@pytest.mark.parametrize(("fixed", "broken", "n"), [(4, 4, 140), (20, 20, 560)], ids=["first look", "last look"])
def test_one_loss_bound(benchmark, fixed, broken, n):
    """A verdict needs about a dozen; the gate's own scenes take seconds."""
    benchmark(loss_upper.__wrapped__, fixed, broken, n, 0.0167)
    assert benchmark.stats["median"] < 0.05  # [s]


def test_one_ruling_of_a_night_costs_less_than_one_exact_bound(capsys):
    """A night asks after every batch, up to 60 times: bets must be cheap beside the bounds that looks are made of."""
    tally = Tally(np.array([[30, 9, 8]]), np.array([[12, 5, 3]]), np.array([[300, 150, 150]]))
    limits = Limits(0.05, 0.05, 3000)
    seconds = {}
    for name, work in {
        "a ruling of a night, three families": lambda: rule_nights(tally, np.array([2.5e-4]), limits),
        "an exact bound of one family": lambda: loss_upper.__wrapped__(30, 12, 300, 2.5e-4),
    }.items():
        began = time.process_time()
        for _ in range(40):
            work()
        seconds[name] = (time.process_time() - began) / 40
    bets, bound = seconds.values()
    with capsys.disabled():
        print("".join(f"\n{name}: {1e3 * s:.2f} ms" for name, s in seconds.items()), f"ratio {bound / bets:.0f}")
    assert bets < bound


@pytest.mark.parametrize("gain", [0.05, 0.10], ids=["+5 points", "+10 points"])
def test_scenes_of_a_night_beside_the_fixed_design(gain, capsys):
    """Scenes of an evaluation are what a night costs; both at the even stake of a year with .09 false promotions."""
    alpha = 0.09 / 365
    planned = fixed_size(*pair(0.85, 0.90, 0.3), alpha, 0.9)
    fixed, broken = pair(0.85, 0.85 + gain, 0.3)
    tonight = nightly_operating(mixed(np.ones(1), np.array([fixed]), np.array([broken])), alpha,
                                Limits(0.05, 0.05, 3000), batch=50, nights=2000, seed=1)
    with capsys.disabled():
        print(f"\n{gain:+.0%}: nightly {tonight.scenes:.0f} scenes, power {tonight.rejects:.3f}; fixed {planned}, "
              f"ratio {planned / tonight.scenes:.1f}")
    assert planned / tonight.scenes > (2 if gain == 0.10 else 1)
