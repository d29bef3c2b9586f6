"""The nightly gate: what a night promotes, what it leaves open, what vetoes, and that its numbers can be checked."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats
from statsmodels.stats.contingency_tables import mcnemar
from statsmodels.stats.proportion import proportion_confint

from pipeline.errors import GateError
from pipeline.simulation.night_scenes import ANCHOR, CANDIDATE, night_mix, night_scenes, played_again, selection_scenes
from pipeline.statistics.betting import FRACTIONS, log_bound, log_gain
from schemas.recipe import GateConfig
from schemas.scene import SceneSpec
from schemas.verdict import Selection, Verdict
from stages.nightly import judge_tonight

OLD, NEW = "a" * 16, "b" * 16
STAKE = 0.09 / 365
NIGHT = GateConfig.model_validate({"nightly": {"batch": 50, "most_scenes": 1500}})
FAMILIES = ("common", "side")


def make_scene(index: int, stratum: str = "common", **changes: object) -> SceneSpec:
    fields = {"family": "gate", "seed": index, "robot": "arm", "scene": "table", "task": "pick-place",
              "stratum": stratum, "object_xy_m": (0.3, 0.0), "object_yaw_rad": 0.0, "object_half_m": 0.02,
              "target_xy_m": (0.3, 0.1)}
    return SceneSpec.model_validate(fields | changes)


def scenes(start: int, stop: int) -> list[SceneSpec]:
    return [make_scene(i, "side" if i % 2 else "common") for i in range(start, stop)]


def by_rates(old: dict[str, float], new: dict[str, float], seed: int = 0):
    """Outcomes drawn by scene, so that both policies meet the same luck half of the time."""
    def evaluate(policy: str, played) -> np.ndarray:
        rates = new if policy == NEW else old
        luck = [np.random.default_rng([seed, s.seed, s.seed % 2 and 7 + (policy == NEW)]).random() for s in played]
        return np.array([u < rates[s.stratum] for u, s in zip(luck, played, strict=True)], bool)
    return evaluate


def by_seed(fixed: Callable[[SceneSpec], bool], broken: Callable[[SceneSpec], bool]):
    """Outcomes by rule: scenes that only the candidate solves, and that only the champion does."""
    return lambda policy, played: np.array([broken(s) if policy == OLD else fixed(s) for s in played], bool)


def judge(evaluate, config: GateConfig = NIGHT, **more) -> Verdict:
    given = {"generation": 4, "stake": STAKE, "families": FAMILIES, "scenes": scenes, "config": config}
    return judge_tonight(NEW, OLD, evaluate=evaluate, **(given | more))


BETTER = by_rates({"common": 0.8, "side": 0.6}, {"common": 0.95, "side": 0.9})
ALIKE = by_rates({"common": 0.9, "side": 0.7}, {"common": 0.9, "side": 0.7})


def test_a_clear_gain_is_promoted_before_the_scenes_are_spent():
    verdict = judge(BETTER)
    assert (verdict.decision, verdict.looks[0].decision) == ("PASS", "PASS")
    assert verdict.scenes < 500 and "every family loses less than 5.0%" in verdict.reason
    assert all(c.log_capital >= -np.log(STAKE) for c in verdict.tonight.capitals)
    assert [c.stratum for c in verdict.tonight.capitals] == ["all", *FAMILIES]


def test_every_number_of_a_verdict_can_be_checked_with_other_tools():
    verdict = judge(BETTER)
    for row, capital in zip(verdict.strata, verdict.tonight.capitals, strict=True):
        low, high = proportion_confint(row.candidate.successes, row.candidate.n, method="wilson")
        assert (row.candidate.low, row.candidate.high) == pytest.approx((low, high))
        two_sided = mcnemar([[0, row.broken], [row.fixed, 0]], exact=True).pvalue
        assert min(row.p_gain, row.p_loss) == pytest.approx(min(two_sided / 2, 1))
        assert row.p_gain == pytest.approx(stats.binomtest(row.fixed, row.fixed + row.broken,
                                                           alternative="greater").pvalue)
        assert (capital.fixed, capital.broken, capital.scenes) == (row.fixed, row.broken, row.candidate.n)
    whole, *families = verdict.tonight.capitals
    mixture = integrate.quad(lambda q: 2 * (2 * q) ** whole.fixed * (2 * (1 - q)) ** whole.broken, 0.5, 1)[0]
    assert np.exp(whole.log_capital) == pytest.approx(mixture)
    assert verdict.p == pytest.approx(1 / mixture)
    for c in families:
        bets = [share / 0.95 for share in FRACTIONS]
        rest = c.scenes - c.fixed - c.broken
        product = np.mean([(1 + b * 1.05) ** c.fixed * (1 + b * 0.05) ** rest * (1 - b * 0.95) ** c.broken
                           for b in bets])
        assert np.exp(c.log_capital) == pytest.approx(product)
    least = min(np.exp(c.log_capital) for c in verdict.tonight.capitals)
    assert verdict.tonight.given_back == pytest.approx(min(STAKE, STAKE * least - 1))


def test_equal_policies_are_left_open_early_and_most_of_the_scenes_stay_unplayed():
    verdict = judge(ALIKE)
    assert verdict.decision == "INCONCLUSIVE" and verdict.scenes < 1500
    assert "no gain shown" in verdict.reason
    assert 0 <= verdict.tonight.given_back < STAKE


def test_an_open_night_names_the_scenes_that_would_have_promoted():
    few = GateConfig.model_validate({"nightly": {"batch": 50, "most_scenes": 500}})
    verdict = judge(by_seed(lambda s: s.seed % 25 in (2, 13), lambda s: s.seed % 25 == 7), few)
    assert verdict.decision == "INCONCLUSIVE"
    assert f"about {verdict.more_scenes} more scenes would promote at these rates" in verdict.reason

    def promotes(scenes: float) -> bool:
        """Whether so many scenes at the rates seen would do, by the formulas of the claims."""
        whole, *families = [c.model_dump() for c in verdict.tonight.capitals]
        grown = scenes / verdict.scenes
        return bool(log_gain(grown * whole["fixed"], grown * whole["broken"]) >= -np.log(STAKE) and all(
            log_bound(grown * c["fixed"], grown * c["broken"], grown * c["scenes"], 0.05) >= -np.log(STAKE)
            for c in families))

    assert promotes(verdict.scenes + verdict.more_scenes + 1)
    assert not promotes(verdict.scenes + 0.9 * verdict.more_scenes)


def test_a_family_that_may_lose_the_margin_keeps_a_gain_from_promotion():
    verdict = judge(by_seed(lambda s: s.seed % 4 == 0 or s.seed % 20 == 1, lambda s: s.seed % 20 == 11))
    assert verdict.decision == "INCONCLUSIVE"
    assert "gain of" in verdict.reason and "loss in side not bounded below 5.0%" in verdict.reason
    assert verdict.strata[2].loss_upper >= 0.05 > verdict.strata[1].loss_upper


def test_a_loss_is_a_fail_and_gives_little_back():
    verdict = judge(by_rates({"common": 0.95, "side": 0.9}, {"common": 0.8, "side": 0.6}))
    assert verdict.decision == "FAIL" and verdict.reason.startswith("loss: ")
    assert verdict.tonight.given_back < STAKE / 10


KEPT = [make_scene(10_000 + k, "side", family="deploy", twin=100) for k in range(4)]


def test_a_lost_regression_scene_vetoes_and_is_named():
    def evaluate(policy, played):
        kept = np.array([s.family == "regression" for s in played])
        lost = np.array([s.object_yaw_rad == 1.0 and policy == NEW for s in played])
        return np.where(kept, ~lost, BETTER(policy, played))

    one = KEPT[2].model_copy(update={"object_yaw_rad": 1.0})
    verdict = judge(evaluate, regression=[*KEPT[:2], one, KEPT[3]], again=played_again)
    assert verdict.decision == "FAIL"
    assert verdict.reason == f"veto: loses 1 of 4 regression scenes that the champion always solves: side {one.seed}"
    lost, = verdict.tonight.regression.lost
    assert (lost.seed, lost.candidate, lost.champion) == (one.seed, 0, 16)
    assert verdict.tonight.given_back == STAKE, "nobody was promoted, so nothing was paid"


def test_a_scene_that_the_champion_fails_now_and_then_cannot_veto():
    def evaluate(policy, played):
        kept = np.array([s.family == "regression" for s in played])
        luck = np.array([s.seed % 5 > 0 and policy == OLD for s in played])
        return np.where(kept, luck, BETTER(policy, played))

    verdict = judge(evaluate, regression=KEPT, again=played_again)
    assert verdict.decision == "PASS" and verdict.tonight.regression.lost == ()
    assert verdict.tonight.regression.chance < 1e-5


def test_regression_scenes_never_promote():
    def evaluate(policy, played):
        kept = np.array([s.family == "regression" for s in played])
        return np.where(kept, policy == NEW, ALIKE(policy, played))

    verdict = judge(evaluate, regression=KEPT, again=played_again)
    assert verdict.decision == "INCONCLUSIVE" and verdict.tonight.regression is None, "they are not even played"


def test_the_choice_among_trainings_stands_in_the_verdict():
    choice = Selection(scenes=200, solved={NEW: 181, "c" * 16: 175}, chosen=NEW)
    assert judge(BETTER, selection=choice).tonight.selection == choice


@pytest.mark.parametrize(("changes", "mend"), [
    ({"config": GateConfig()}, "add `nightly: {}` below `gate:` in the recipe"),
    ({"stake": 0.0}, "the budget of this year is spent"),
    ({"regression": KEPT}, "hand in `again`"),
    ({"families": ("common",)}, "draw scenes from the families that were fixed beforehand: common"),
    ({"regression": KEPT, "again": lambda scene, times: [scene] * times}, "none of them on a twin"),
    ({"scenes": lambda a, b: [make_scene(i, family="exam") for i in range(a, b)]}, "from the family 'gate'"),
], ids=["no nightly gate", "no money", "no way to play again", "a strange family", "on a twin", "exam scenes"])
def test_a_night_that_cannot_be_judged_is_refused_with_the_mend(changes, mend):
    with pytest.raises(GateError, match=f"mend: .*{mend}"):
        judge(BETTER, **changes)


bits = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=60, max_size=60)
SMALL = GateConfig.model_validate({"margin": 0.3, "nightly": {"batch": 10, "most_scenes": 60}})


@settings(deadline=None, max_examples=20)
@given(bits)
def test_a_verdict_is_a_function_of_the_outcomes_and_both_ways_never_promotes(outcomes):
    def evaluate(policy, played):
        return np.array([outcomes[s.seed][policy == NEW] for s in played], bool)

    def mirrored(policy, played):
        return evaluate(OLD if policy == NEW else NEW, played)

    verdict = judge(evaluate, SMALL, stake=0.1)
    assert verdict == judge(evaluate, SMALL, stake=0.1)
    shown = all(c.log_capital >= np.log(10) for c in verdict.tonight.capitals)
    assert shown or verdict.decision != "PASS"
    assert (verdict.more_scenes is None) or verdict.decision == "INCONCLUSIVE"
    assert not verdict.decision == judge(mirrored, SMALL, stake=0.1).decision == "PASS"


def test_the_id_names_the_causes_and_the_json_of_other_verdicts_is_as_it_was():
    verdict = judge(BETTER)
    assert verdict.id == judge(BETTER).id != judge(BETTER, stake=STAKE / 2).id
    assert "tonight" not in verdict.model_copy(update={"tonight": None}).model_dump_json()
    assert Verdict.model_validate_json(verdict.model_dump_json()) == verdict
    assert "nightly" not in GateConfig().model_dump_json() and "seeds" not in GateConfig().model_dump_json()


def test_no_scene_of_a_night_is_played_by_another_part_of_it():
    mix = night_mix("pick-place", ["beside", "large"], 0.5)
    numbers = {"seed": 3, "generation": 7, "mix": mix}
    drawn = partial(night_scenes, "pick-place", "arm", "table", start=0, stop=400)
    parts = [drawn(sequence=CANDIDATE, **numbers), drawn(sequence=ANCHOR, **numbers),
             drawn(sequence=CANDIDATE, **(numbers | {"generation": 8})),
             selection_scenes("pick-place", "arm", "table", n=400, **numbers),
             played_again(KEPT[0], 50), played_again(KEPT[1], 50)]
    seeds = [s.seed for part in parts for s in part]
    assert len(set(seeds)) == len(seeds)
    assert {s.family for s in parts[3]} == {"selection"} and {s.twin for s in parts[4]} == {None}
    assert {(s.object_xy_m, s.target_xy_m) for s in parts[4]} == {(KEPT[0].object_xy_m, KEPT[0].target_xy_m)}
    counts = [sum(s.stratum == name for s in parts[0]) for name in mix]
    assert stats.chisquare(counts, [400 * share for share in mix.values()]).pvalue > 0.01
