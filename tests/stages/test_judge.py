"""Judge: recorded deployments of the champion, in the eyes of a candidate, and corrections where somebody was wrong."""

import numpy as np
import pytest

from pipeline.counterfactual.cases import cases_of
from pipeline.counterfactual.summary import Subject
from pipeline.counterfactual.windows import first_window
from pipeline.recording import read_episode
from schemas.counterfactual import JudgeConfig, ShadowReport
from stages.harvest import harvest
from stages.judge import judge

CONFIG = JudgeConfig(draws=8, most=8, checked=4)


@pytest.fixture(scope="module")
def judged(attempts, learnt, policy, recipe, twin):
    """Judges the other policy by what the champion met."""

    def run(champion=learnt.champion, candidate=learnt.other, config=CONFIG) -> ShadowReport:
        subject = Subject("0" * 16, 0, twin, champion.id, candidate.id, former=False)
        return judge(attempts, policy(champion), policy(candidate), recipe, subject=subject, config=config)

    return run


@pytest.fixture(scope="module")
def report(judged) -> ShadowReport:
    return judged()


def test_the_disagreements_are_those_that_a_rider_recorded(report, attempts, learnt):
    windows = {e.id: first_window(t.shadows[learnt.other.id].disagreement, CONFIG) for e, t in attempts}
    assert report.rows[0].apart == sum(w is not None for w in windows.values()) > 0
    assert report.judgements
    for j in report.judgements:
        window = windows[j.episode]
        assert (j.tick, j.lasted) == (window.start, window.stop - window.start)
        assert j.disagreement == pytest.approx(window.disagreement)
    apart = np.concatenate([t.shadows[learnt.other.id].disagreement for _, t in attempts])
    assert report.agreement == pytest.approx((apart < CONFIG.threshold).mean())


def test_every_recording_of_the_twin_is_reproduced_and_the_report_repeats(report, judged):
    assert report.refusals == () and report.rows[0].judged == min(8, report.rows[0].apart)
    assert judged() == report
    assert ShadowReport.model_validate_json(report.model_dump_json()) == report


def test_rows_by_stratum_add_up_to_the_row_of_all(report, attempts):
    total, parts = report.rows[0], report.rows[1:]
    assert total.stratum == "all" and {r.stratum for r in parts} == {"common", "beside", "large"}
    for name in ("attempts", "apart", "judged", "undecided"):
        assert getattr(total, name) == sum(getattr(r, name) for r in parts)
    assert total.attempts == len(attempts) and sum(total.right.values()) == total.judged
    assert report.checked == 4 and report.from_start.low <= report.from_start.estimate <= report.from_start.high


def test_recordings_of_another_champion_are_refused(judged, learnt):
    wrong = judged(champion=learnt.other, candidate=learnt.champion, config=JudgeConfig(draws=4, most=3, checked=0))
    assert not wrong.judgements and len(wrong.refusals) == 3
    assert all("does not give the recorded action" in r.reason for r in wrong.refusals)
    assert wrong.verdict == "hold" and wrong.change is None


def test_only_moments_at_which_somebody_was_wrong_are_corrected_and_from_there_on(report, attempts, recipe, twin,
                                                                                  software, tmp_path):
    cases = cases_of(report.judgements, 0)
    assert cases, "two policies of so little training err somewhere"
    done = harvest(attempts, recipe, twin=twin, generation=0, folder=tmp_path, software=software, judged=cases)
    assert {c.id for c in done.cases} == {c.id for c in cases} and 0 < len(done.recorded) <= len(cases)
    by_id = {e.id: t for e, t in attempts}
    for case, recorded in zip(done.chosen, done.recorded, strict=True):
        episode, trace = read_episode(recorded.path)
        at = max(1, case.tick)
        assert episode.parent == case.episode and episode.origin == "corrected"
        assert episode.segments[0].stop == at + recipe.harvest.operator_delay_ticks
        assert np.array_equal(trace.sim_state[:at], by_id[case.episode].sim_state[:at])
        if at < len(by_id[case.episode]):  # the moment itself comes back to the bit
            assert np.array_equal(trace.sim_state[at], by_id[case.episode].sim_state[at])
