import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from flows.run.steps_api import StepResult
from flows.service.display import Display, chart, duration, show_result, success_table, verdict_lines
from flows.service.estimate import Clock, expected_s, plan
from pipeline.recipes import load_recipe
from schemas.summary import GateLine, Generation, LoopResult, Paired
from schemas.verdict import Proportion, StratumResult, Verdict

ID = "0123456789abcdef"
RECIPE = load_recipe("default")


def proportion(rate: float) -> Proportion:
    return Proportion(n=400, successes=round(400 * rate), rate=rate, low=max(rate - 0.03, 0), high=min(rate + 0.03, 1))


def lap(generation: int, rare: float, verdict: str = "INCONCLUSIVE") -> Generation:
    kinds = {"all": 0.9, "common": 0.96, "rare": rare, "deployment_mix": 0.91}
    return Generation(
        generation=generation,
        dataset_version=ID,
        policy=ID,
        success={kind: proportion(rate) for kind, rate in kinds.items()},
        gate=GateLine(verdict=verdict, p=0.004),
        robot_s=750.0,
        corrections=12,
        wall_s={},
    )


def printed(*things: object) -> str:
    out = io.StringIO()
    console = Console(file=out, width=80)
    for thing in things:
        console.print(thing)
    return out.getvalue()


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.4, "0 s"), (59.6, "1 min 0 s"), (125, "2 min 5 s"), (3840, "1 h 4 min")]
)
def test_durations_are_told_as_people_do(seconds, words):
    assert duration(seconds) == words


def test_the_table_shows_every_kind_of_start_with_its_interval_in_80_columns():
    text = printed(success_table(tuple(lap(g, 0.04 + 0.28 * g) for g in range(4)), "Success"))
    rows = text.splitlines()[2:]
    assert len(rows) == 4
    assert rows[3].strip() == "3 .900 [.87 .93] .960 [.93 .99] .880 [.85 .91] .910 [.88 .94] INCONCLUSIVE"


def test_the_chart_rises_with_the_success():
    bars = next(line for line in chart((lap(0, 0.0), lap(1, 0.5), lap(2, 1.0))).plain.splitlines() if "rare" in line)
    assert bars.split()[1:3] == ["▄▄▄", "███"]
    assert bars.endswith("0.00 -> 1.00")


def test_the_verdict_tells_each_stratum_and_what_would_decide():
    stratum = StratumResult(
        stratum="side", candidate=proportion(0.8), champion=proportion(0.5), fixed=30, broken=2, loss_upper=0.031
    )
    verdict = Verdict(
        id=ID, candidate=ID, champion=ID, generation=1, decision="INCONCLUSIVE", reason="not enough scenes",
        strata=(stratum,), scenes=800, margin=0.05, more_scenes=400,
    )
    text = "\n".join(verdict_lines(verdict))
    for words in ("INCONCLUSIVE", "800 scenes", "side", "320/400", "fixed 30, broken 2", "at most 0.031", "400 more"):
        assert words in text


def test_the_end_names_report_memory_seed_and_what_the_pair_means(tmp_path):
    out = io.StringIO()
    result = LoopResult(
        generations=(lap(0, 0.1), lap(1, 0.8)), paired=Paired(fixed=70, broken=1, p=1e-9), wall_s=119.0,
        peak_pss_mb=1200.0, seed=3, twin=104,
    )
    show_result(Console(file=out, width=80), result, None, tmp_path / "a report with a long name.html")
    for words in ("70 fixed, 1 broken", "nothing more", "1 min 59 s, 1200 MB at most, seed 3, twin 104"):
        assert words in out.getvalue()
    assert f"Report: {tmp_path / 'a report with a long name.html'}\n" in out.getvalue()


def test_a_terminal_sees_stage_share_and_time_left_and_keeps_only_the_finished_lines():
    out = io.StringIO()
    console = Console(file=out, width=100, force_terminal=True, color_system=None)
    step = plan(RECIPE, control=False)[0]
    with Display(RECIPE, console) as display:
        display.begin(step)
        display.advance(25, 50)
        display._bar.refresh()
        display.end(step, StepResult((ID,), "50 demonstrations kept"))
    assert "generation 0/3 collect 25/50" in out.getvalue()
    assert "% of the loop" in out.getvalue()
    assert "left" in out.getvalue()
    assert "50 demonstrations kept" in out.getvalue()


def test_a_pipe_sees_one_line_a_stage_without_control_characters():
    out = io.StringIO()
    step = plan(RECIPE, control=False)[0]
    with Display(RECIPE, Console(file=out)) as display:
        display.begin(step)
        display.advance(1, 50)
        display.end(step, StepResult((ID,), "50 demonstrations kept", resumed=True))
    assert out.getvalue() == "generation 0/3  collect      kept  50 demonstrations kept\n"


@given(pace=st.floats(0.2, 5.0), finished=st.integers(1, 30))
def test_the_estimate_learns_the_pace_of_this_machine(pace, finished):
    steps = plan(RECIPE, control=False)
    clock = Clock(steps, RECIPE)
    for step in steps[:finished]:
        clock.finish(step, pace * expected_s(step, RECIPE), resumed=False)
    left = sum(expected_s(step, RECIPE) for step in steps[finished:])
    estimate = clock.left_s(steps[finished], 0.0, 0.0)
    assert estimate == pytest.approx(pace * left, rel=1e-6)


def test_stages_that_were_only_looked_up_do_not_make_the_rest_look_short():
    steps = plan(RECIPE, control=False)
    clock = Clock(steps, RECIPE)
    before = clock.left_s(steps[4], 0.0, 0.0)
    for step in steps[:4]:
        clock.finish(step, 0.001, resumed=True)
    after = clock.left_s(steps[4], 0.0, 0.0)
    assert after == pytest.approx(before - sum(expected_s(step, RECIPE) for step in steps[:4]))
    assert 0 < clock.share_done() < 1
