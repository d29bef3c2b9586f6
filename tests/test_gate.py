"""The gate: what is promoted, what is refused, what is left open, and why it says so."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import GateError
from pipeline.statistics import spend
from pipeline.statistics.promotion import compare_strata, rule
from schemas.recipe import GateConfig
from schemas.scene import SceneSpec
from stages.gate import gate

OLD, NEW = "a" * 16, "b" * 16
SMALL = GateConfig(looks=(20, 40), margin=0.2)
PLANNED = GateConfig(looks=(200, 400, 800), rare_share=0.3)


def make_scene(index: int, stratum: str = "common", **changes: object) -> SceneSpec:
    fields = {"family": "gate", "seed": index, "robot": "arm", "scene": "table", "task": "pick-place",
              "stratum": stratum, "object_xy_m": (0.3, 0.0), "object_yaw_rad": 0.0, "object_half_m": 0.02,
              "target_xy_m": (0.3, 0.1)}
    return SceneSpec.model_validate(fields | changes)


def strata(every: int, rare: str = "side") -> Callable[[int, int], list[SceneSpec]]:
    """Scenes of which one in `every` is rare."""
    return lambda start, stop: [make_scene(i, rare if i % every == 0 else "common") for i in range(start, stop)]


def solves(**policies: Callable[[SceneSpec], bool]):
    """Outcomes by rule, the keys being 'old' and 'new'."""
    by_id = {{"old": OLD, "new": NEW}[name]: rule for name, rule in policies.items()}
    return lambda policy, scenes: np.array([by_id[policy](s) for s in scenes], dtype=bool)


def always(_: SceneSpec) -> bool:
    return True


def judge(scenes, evaluate, config: GateConfig = PLANNED, champion: str | None = OLD, **more):
    return gate(NEW, champion, generation=1, scenes=scenes, evaluate=evaluate, config=config, **more)


def test_a_lap_that_learnt_the_rare_starts_passes_at_the_first_look():
    verdict = judge(strata(3), solves(
        old=lambda s: s.stratum == "common" and s.seed % 20 != 1,
        new=lambda s: s.seed % 40 != 2))
    assert (verdict.decision, verdict.scenes) == ("PASS", 200)
    assert [s.stratum for s in verdict.strata] == ["all", "common", "side"]
    assert "gain in" in verdict.reason and "side (" in verdict.reason
    assert verdict.p <= 0.05
    assert [(look.scenes, look.decision) for look in verdict.looks] == [(200, "PASS")]
    assert sum(s.fixed for s in verdict.strata[1:]) == verdict.strata[0].fixed


def test_a_candidate_like_the_champion_is_not_played_to_the_end_of_the_budget():
    verdict = judge(strata(3), solves(old=lambda s: s.seed % 9 != 0, new=lambda s: s.seed % 9 != 0))
    assert (verdict.decision, verdict.scenes, verdict.more_scenes) == ("INCONCLUSIVE", 200, None)
    assert "stopped early: a gain has become unlikely" in verdict.reason
    assert "no number of scenes" in verdict.reason


def test_the_same_policy_on_both_sides_is_played_once():
    played = []

    def evaluate(policy, scenes):
        played.append(len(scenes))
        return np.ones(len(scenes), bool)

    assert judge(strata(3), evaluate, champion=NEW).decision == "INCONCLUSIVE"
    assert played == [200]


def test_a_loss_in_one_stratum_fails_a_candidate_that_gains_overall():
    verdict = judge(strata(4), solves(
        old=lambda s: s.stratum == "side" or s.seed % 2 == 0,
        new=lambda s: s.stratum == "common" or s.seed % 8 == 0))
    assert verdict.decision == "FAIL"
    assert verdict.reason.startswith("loss in side (")
    assert verdict.strata[0].fixed > verdict.strata[0].broken


def test_a_gain_that_costs_the_common_starts_a_little_is_left_open_and_says_what_is_missing():
    verdict = judge(strata(3), solves(
        old=lambda s: s.stratum == "common" and s.seed % 19 != 1,
        new=lambda s: s.stratum == "side" or s.seed % 11 != 1))
    assert verdict.decision == "INCONCLUSIVE"
    assert "gain shown in" in verdict.reason and "loss in common not bounded below 5.0%" in verdict.reason
    assert verdict.more_scenes > 0 and f"about {verdict.more_scenes} more scenes" in verdict.reason


def test_a_stratum_with_too_few_scenes_stops_the_gate_with_the_mend():
    verdict = judge(strata(100, "large"), solves(old=lambda s: s.seed % 2 == 0 and s.stratum == "common",
                                                 new=lambda s: s.stratum == "common"))
    assert (verdict.decision, verdict.scenes) == ("INCONCLUSIVE", 200)
    assert "large gets too few scenes within the budget, raise gate.looks or gate.rare_share" in verdict.reason


def test_more_scenes_are_played_when_the_first_look_leaves_it_open():
    told = []
    verdict = judge(strata(3), solves(
        old=lambda s: s.stratum == "common" and s.seed % 20 != 1,
        new=lambda s: s.stratum == "side" or s.seed % 20 != 2), progress=lambda *counts: told.append(counts))
    assert (verdict.decision, verdict.scenes) == ("PASS", 400)
    assert told == [(200, 800), (400, 800)]
    assert [look.decision for look in verdict.looks] == ["continue", "PASS"]


@pytest.mark.parametrize(("solved", "decision"), [(120, "BOOTSTRAP"), (105, "FAIL")])
def test_generation_0_is_released_when_its_lower_bound_reaches_the_threshold(solved, decision):
    verdict = judge(strata(10**6), solves(new=lambda s: s.seed < solved), champion=None)
    assert (verdict.decision, verdict.champion, verdict.scenes, verdict.p) == (decision, None, 200, None)
    assert f"common: {solved - 1} of 199 solved" in verdict.reason


def test_the_bootstrap_looks_at_common_starts_where_there_are_some():
    verdict = judge(strata(2), solves(new=lambda s: s.stratum == "common"), champion=None)
    assert verdict.decision == "BOOTSTRAP"
    only_rare = judge(strata(1), solves(new=lambda s: s.seed % 5 == 0), champion=None)
    assert only_rare.decision == "FAIL" and "all: 40 of 200" in only_rare.reason


@pytest.mark.parametrize(("scenes", "mend"), [
    (lambda a, b: [make_scene(i) for i in range(a, b - 1)], "must give scenes start..stop"),
    (lambda a, b: [make_scene(i, family="exam") for i in range(a, b)], "draw gate scenes from the family 'gate'"),
    (lambda a, b: [make_scene(i, twin=3) for i in range(a, b)], "never from a twin"),
    (lambda a, b: [make_scene(0) for _ in range(a, b)], "give each gate scene a seed of its own"),
], ids=["too few", "exam scenes", "a twin's scenes", "repeated"])
def test_the_gate_refuses_scenes_that_it_must_not_judge_by(scenes, mend):
    with pytest.raises(GateError, match=f"mend: .*{mend}"):
        judge(scenes, solves(old=always, new=always))


@pytest.mark.parametrize("outcome", [np.ones(3, bool), np.ones(200)], ids=["too few", "not boolean"])
def test_the_gate_refuses_outcomes_that_do_not_fit_the_scenes(outcome):
    with pytest.raises(GateError, match=r"policy b{16}\n  mend: return one boolean a scene"):
        judge(strata(3), lambda policy, scenes: outcome)


bits = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=40, max_size=40)
kinds = st.lists(st.sampled_from(["common", "side", "large"]), min_size=40, max_size=40)


@settings(deadline=None, max_examples=60)
@given(bits, kinds)
def test_the_verdict_is_a_function_of_the_outcomes_and_can_be_checked_by_hand(outcomes, labels):
    def scenes(start, stop):
        return [make_scene(i, labels[i]) for i in range(start, stop)]

    def evaluate(policy, played):
        return np.array([outcomes[s.seed][policy == NEW] for s in played], bool)

    verdict = judge(scenes, evaluate, SMALL)
    assert verdict == judge(scenes, evaluate, SMALL)
    last = verdict.looks[-1]
    asked = verdict.strata if len(verdict.strata) > 2 else verdict.strata[:1]
    gained = min(s.p_gain for s in asked) * len(asked) <= last.alpha
    lost = min(s.p_loss for s in asked) * len(asked) <= last.alpha
    bounded = all(s.loss_upper < SMALL.margin for s in verdict.strata[1:])
    assert verdict.decision == ("FAIL" if lost else "PASS" if gained and bounded else "INCONCLUSIVE")
    assert (verdict.p <= SMALL.alpha) == gained
    assert (verdict.more_scenes is None) or verdict.decision == "INCONCLUSIVE"
    mirrored = judge(scenes, lambda policy, played: evaluate({OLD: NEW, NEW: OLD}[policy], played), SMALL)
    assert not verdict.decision == mirrored.decision == "PASS"


def test_the_id_names_the_causes():
    outcomes = solves(old=lambda s: s.seed % 2 == 0, new=always)
    first = judge(strata(3), outcomes)
    assert first.id == judge(strata(3), outcomes).id
    assert first.id != judge(strata(4), outcomes).id
    assert first.id != judge(strata(3), outcomes, GateConfig(looks=(200, 400, 800), rare_share=0.3, margin=0.06)).id


def test_equal_policies_are_promoted_more_rarely_than_alpha():
    rng, config = np.random.default_rng(4), GateConfig(looks=(40, 80, 160))
    labels = ["side" if i % 3 == 0 else "common" for i in range(160)]
    alphas, promoted = spend(config.looks, config.alpha), 0
    for _ in range(200):
        candidate, champion = rng.random((2, 160)) < 0.8
        for look, (n, alpha) in enumerate(zip(config.looks, alphas, strict=True)):
            results = compare_strata(labels[:n], candidate[:n], champion[:n], alpha)
            decision = rule(results, config, look).decision
            if decision != "continue":
                break
        promoted += decision == "PASS"
    assert promoted / 200 <= config.alpha
