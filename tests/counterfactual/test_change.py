"""What a promotion would change: the estimate, its interval, and what is said of it."""

import numpy as np
import pytest

from pipeline.counterfactual.change import Sampled, expected_change, mean_difference
from pipeline.counterfactual.sampling import sample
from pipeline.counterfactual.summary import decide, further_attempts
from pipeline.counterfactual.windows import Window
from pipeline.errors import ConfigError
from schemas.counterfactual import Change, JudgeConfig, ShadowRow


def row(stratum: str, *change: float) -> ShadowRow:
    return ShadowRow(stratum=stratum, attempts=150, apart=20, judged=20, right={}, undecided=0,
                     change=Change(estimate=change[0], low=change[1], high=change[2]) if change else None)


def test_the_change_is_the_share_apart_times_the_mean_gain():
    found = expected_change(Sampled(100, 20, [1.0] * 10 + [0.0] * 10), np.random.default_rng(0))
    assert found.estimate == pytest.approx(0.1) and 0 < found.low < 0.1 < found.high < 0.25


def test_attempts_without_a_disagreement_are_no_proof_that_there_never_is_one():
    few, many = (expected_change(Sampled(n, 0, []), np.random.default_rng(0)) for n in (50, 500))
    assert few.estimate == 0 and few.low < -0.01 and few.high > 0.01
    assert few.high - few.low > 5 * (many.high - many.low) > 0


def test_the_interval_holds_the_truth_in_nearly_all_of_many_deployments():
    rng, held = np.random.default_rng(1), 0
    for _ in range(100):
        gains = [g for g in rng.choice([1.0, 0.0, -1.0], size=150, p=[0.12, 0.84, 0.04]) if g or rng.random() < 0.4]
        judged = rng.permutation(gains)[:30]
        found = expected_change(Sampled(150, len(gains), judged.tolist()), rng)
        held += found.low <= 0.08 <= found.high
    assert held >= 90


def test_a_sample_that_prefers_large_disagreements_tilts_no_mean():
    rng = np.random.default_rng(2)
    windows = [Window(0, int(t), 0.1) if rng.random() < 0.7 else None for t in rng.integers(3, 100, 150)]
    gains = {i: float(w.stop > 50) for i, w in enumerate(windows) if w}
    means, areas = [], []
    for seed in range(300):
        chosen = sample(windows, JudgeConfig(most=30, seed=seed))
        assert len(chosen) == 30 and set(chosen) <= set(gains)
        means.append(np.average([gains[i] for i in chosen], weights=list(chosen.values())))
        areas.append(np.mean([windows[i].stop for i in chosen]))
    assert np.mean(means) == pytest.approx(np.mean(list(gains.values())), abs=0.02)
    assert np.mean(areas) > np.mean([w.stop for w in windows if w]) + 5
    assert sample(windows, JudgeConfig()) == dict.fromkeys(gains, 1.0)


def test_disagreements_of_which_none_was_judged_give_no_change():
    with pytest.raises(ConfigError, match=r"0 judged of 3 disagreements(.|\n)*mend: judge at least one .*--most"):
        expected_change(Sampled(10, 3, []), np.random.default_rng(0))


def test_what_was_missed_is_a_mean_of_differences():
    found = mean_difference(np.array([1.0, 0.5, 0.0]), np.array([0.5, 0.5, 0.0]), np.random.default_rng(0))
    assert found.estimate == pytest.approx(1 / 6) and found.low < 0 < found.high


@pytest.mark.parametrize(("rows", "missed", "former", "verdict", "says"), [
    ([(0.1, 0.05, 0.15)], None, False, "promote", "the candidate is better: expected change +10.0 [+5.0 +15.0]"),
    ([(0.1, 0.05, 0.15)], None, True, "roll back", "the candidate is better"),
    ([(-0.1, -0.15, -0.05)], None, True, "hold", "the candidate is worse"),
    ([(0.02, -0.02, 0.06)], None, False, "hold", "some 450 more attempts would decide"),
    ([(0.1, 0.05, 0.15), (-0.5, -0.8, -0.1)], None, False, "hold", "starts of kind 'beside' lose"),
    ([(0.1, 0.05, 0.15)], (-0.08, -0.12, -0.02), False, "hold", "played from the start the candidate gains less"),
    ([()], None, False, "hold", "no disagreement could be judged"),
], ids=["surely better", "a former champion", "worse", "not sure", "a stratum loses", "the check contradicts",
        "nothing"])
def test_only_what_is_sure_is_promoted(rows, missed, former, verdict, says):
    missed = missed and Change(estimate=missed[0], low=missed[1], high=missed[2])
    word, reason = decide([row(n, *r) for n, r in zip(("all", "beside"), rows, strict=False)], missed, former=former)
    assert word == verdict and says in reason


def test_attempts_that_would_decide_grow_as_the_square_of_the_doubt():
    assert further_attempts(100, Change(estimate=0.02, low=-0.02, high=0.06)) == 300
    assert further_attempts(100, Change(estimate=0.0, low=-0.02, high=0.02)) is None
