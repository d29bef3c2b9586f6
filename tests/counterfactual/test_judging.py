"""Who was right: both policies go on from the moment at which they parted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.counterfactual.cases import cases_of
from pipeline.counterfactual.variation import BIAS_SD_M, SPREAD, VARIATIONS, branch_seed, vary
from pipeline.counterfactual.windows import first_window
from schemas.counterfactual import JudgeConfig
from schemas.hardcase import HardCase


def test_the_champion_is_right_where_the_candidate_looks_beside_the_cube(close_call, attempts):
    assert len(close_call.judgements) == len(attempts) and not close_call.refusals
    for j in close_call.judgements:
        assert (j.verdict, j.wrong, j.decided, j.gain) == ("champion", "candidate", True, -1.0)
        assert sum(j.candidate.why.values()) == 4 and j.champion.why == {}
        assert str(j.candidate.main_reason).startswith("timed-out-")
        assert -1.0 <= j.gain_low <= j.gain <= j.gain_high < 0


def test_the_candidate_is_right_where_the_champion_was_recorded_to_fail(recorded, judged, aiming):
    found = judged(recorded(aiming(0.05), 2), aiming(0.05), aiming())
    assert [(j.verdict, j.wrong, j.gain) for j in found.judgements] == [("candidate", "champion", 1.0)] * 2


def test_neither_is_right_where_both_miss(recorded, judged, aiming):
    found = judged(recorded(aiming(0.05), 2), aiming(0.05), aiming(-0.05))
    assert [(j.verdict, j.wrong) for j in found.judgements] == [("neither", "both")] * 2


def test_both_are_right_where_they_differ_in_taste_only(judged, attempts, aiming):
    found = judged(attempts[:2], aiming(), aiming(0.006), threshold=0.002, lasting=1)
    assert [(j.verdict, j.wrong) for j in found.judgements] == [("both", None)] * 2


def test_a_policy_never_disagrees_with_itself(judged, attempts, aiming):
    found = judged(attempts, aiming(), aiming(), threshold=1e-9, lasting=1)
    assert found.windows == (None,) * 4 and not found.judgements
    assert all((apart == 0).all() for apart in found.apart)


def test_a_judgement_does_not_depend_on_its_company(judged, attempts, close_call, aiming):
    alone = judged(attempts[2:3], aiming(), aiming(0.05))
    assert alone.judgements[0] == close_call.judgements[2]


def test_other_draws_are_another_judgement(judged, attempts, close_call, aiming):
    again = judged(attempts[:1], aiming(), aiming(0.05), seed=1)
    assert again.judgements[0].id != close_call.judgements[0].id


def test_wrong_moments_become_hard_cases_that_say_who_and_why(close_call, recorded, judged, aiming):
    worse = judged(recorded(aiming(0.05), 2), aiming(0.05), aiming())
    cases = cases_of([*close_call.judgements, *worse.judgements], generation=2, arm="study")
    assert [c.wrong for c in cases] == ["champion"] * 2 + ["candidate"] * 4
    assert all(c.family.startswith("timed-out-") and c.trigger == "disagreement" for c in cases)
    assert [c.family for c in cases[2:]] == [c.judgement.candidate.main_reason for c in cases[2:]]
    assert cases == cases_of([*worse.judgements, *close_call.judgements], generation=2, arm="study")
    assert [HardCase.model_validate_json(c.model_dump_json()) for c in cases] == cases
    assert not cases_of([], 0)


def test_a_hard_case_of_a_trigger_reads_as_it_did_before_there_were_judgements():
    case = HardCase(id="0" * 16, episode="1" * 16, trigger="stall", tick=3, family="stall-reach", stratum="common",
                    generation=0)
    assert not {"wrong", "judgement"} & case.model_dump().keys()


@given(st.lists(st.floats(0, 1), max_size=40), st.integers(1, 5))
def test_a_window_is_the_first_stretch_that_lasts(apart, lasting):
    found = first_window(np.array(apart), JudgeConfig(threshold=0.5, lasting=lasting))
    over = [d >= 0.5 for d in apart]
    first = next((k for k in range(len(apart) - lasting + 1) if all(over[k:k + lasting])), None)
    assert (found.start if found else None) == first
    if found:
        assert all(over[found.start:found.stop]) and not any(over[found.stop:found.stop + 1])
        assert found.disagreement == pytest.approx(np.mean(apart[found.start:found.stop]))


def test_a_branch_draws_physics_close_to_the_robots_own_and_the_same_for_both_policies(draws, attempts):
    scene = attempts[0][0].scene
    seeds = [branch_seed(scene, 5, k, 0) for k in range(200)]
    assert len(set(seeds)) == 200 and seeds[3] == branch_seed(scene, 5, 3, 0)
    assert branch_seed(scene, 6, 3, 0) != seeds[3]
    tables = [{d.name: d.value for d in vary(draws, seed)} for seed in seeds]
    own = {d.name: d.value for d in draws}
    assert all(t[name] == own[name] for t in tables for name in own.keys() - VARIATIONS.keys())
    ratio = np.array([t["kp"] / own["kp"] for t in tables])
    assert np.log(ratio).std() == pytest.approx(SPREAD, rel=0.2) and ratio.mean() == pytest.approx(1, abs=0.01)
    assert np.std([t["bias_x"] for t in tables]) == pytest.approx(BIAS_SD_M, rel=0.2)
