"""The study of shadow mode, on attempts whose answer is known; the report's charts; the command line of the ring."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

from flows.studies.shadow import LENGTH, alarms, fitted, measured
from flows.studies.shadow_attempts import SETTINGS, Attempt
from flows.studies.shadow_tables import tables
from pipeline.report.data import ReportData
from pipeline.report.signals import signals
from pipeline.signals.curves import curves
from pipeline.signals.warning import WEIGHTS
from schemas.recipe import Recipe
from schemas.summary import Lap, LoopResult, Paired


def attempt(seed: int, *, failed: bool) -> Attempt:
    """Successes end at tick 50, failures at 60; what failed was far from everything, later than it was apart."""
    rng, n = np.random.default_rng(seed), 60 if failed else 50
    risk = 2.0 * failed * (np.arange(n) >= 15)
    noise = rng.normal(scale=0.1, size=(2, n))
    return Attempt(failed, "beside" if failed else "common", {
        "disagreement, generation 1": 0.01 + 0.2 * failed + 0 * risk, "distance": 1 + risk + np.abs(noise[0]),
        "revision": np.append(np.nan, 0.02 + np.abs(noise[1][1:])), "apart": 0.01 + 0.2 * failed + 0 * risk,
        "spread": np.full(n, 0.1), "flips": np.zeros(n), "warning": np.append(np.nan, 0.1 + 0.4 * risk[1:])})


@pytest.fixture(scope="module")
def runs():
    return [[attempt(100 * k + i, failed=i % 5 == 0) for i in range(40)] for k in range(2)]


@pytest.fixture(scope="module")
def found(runs):
    return measured(runs, SETTINGS[0], {"beside"})


def test_signals_that_know_score_high_and_those_that_do_not_score_a_half(found):
    score = {name: {window: by[window]["all"] for window in by} for name, by in found["auroc"].items()}
    assert score["disagreement, generation 1"]["10"] == [1, 1, 1]
    assert score["distance"]["40"] == [1, 1, 1] and 0.2 < score["distance"]["10"][0] < 0.8
    assert score["spread"]["80"] == [0.5, 0.5, 0.5]
    assert (found["failed"], found["failed_rare"], found["attempts"]) == (16, 16, 80)


def test_an_attempts_length_is_a_control_and_cannot_tell_while_all_go_on(found):
    assert found["auroc"][LENGTH]["40"]["all"] == [0.5, 0.5, 0.5]
    assert found["auroc"][LENGTH]["80"]["all"] == [1, 1, 1], "failures are longer here: a window beyond leaks it"
    assert found["at_risk"]["40"] == [16, 64] and found["at_risk"]["80"] == [0, 0]
    assert found["auroc"]["distance"]["80"]["running"] is None


def test_alarms_say_how_many_how_wrongly_and_how_early(runs):
    found = {rule.split()[0]: told for rule, told in alarms(runs).items()}
    assert found["apart"] == {"failures": 16, "told": 16, "successes": 64, "false": 0, "ticks_left": [45, 45, 45]}
    assert found["warning"]["ticks_left"] == [40, 40, 40], "five ticks from tick 15 on, of 60"


def test_the_fit_gives_weight_to_what_tells(runs):
    weights = fitted({"first": runs})["weights"]
    assert list(weights) == list(WEIGHTS) and weights["distance"] > 5 * abs(weights["revision"])


def test_the_tables_show_every_signal_with_its_interval(runs, found):
    everything = {"settings": {"first": found}, "fit": fitted({"first": runs}),
             "shipped": {"bias": 0, "weights": {}}, "cpu_s": 1}
    out = io.StringIO()
    Console(file=out, width=160).print(*tables(everything))
    text = out.getvalue()
    assert "16 of 80" in text and "1.000 [1.00 1.00]" in text and "16 / 64" in text
    assert all(name in text for name in (*runs[0][0].signals, LENGTH, "0 of 64 successes", "45 [45 45]"))


def test_the_report_draws_failures_beside_successes(runs):
    made = curves([a.signals for a in runs[0]], np.array([a.failed for a in runs[0]]))
    assert made["warning"]["success"][:3] == [None, 0.1, 0.1]
    assert (len(made["distance"]["failure"]), len(made["distance"]["success"])) == (60, 50)
    result = LoopResult(generations=(), paired=Paired(fixed=0, broken=0, p=1), wall_s=0, peak_pss_mb=0, seed=0, twin=0)
    laps = (Lap.model_validate({"generation": 0, "signals": made}), Lap(generation=1))
    data = ReportData(Recipe(name="a"), "hardcase loop", result, laps=laps)
    drawn = "".join(signals(data))
    assert "Distance to the training data" in drawn and "attempts that failed" in drawn and "generation 0" in drawn
    assert signals(ReportData(Recipe(name="a"), "hardcase loop", result)) == []


def test_too_few_failures_have_no_curve(runs):
    few = [a for a in runs[0] if not a.failed] + [a for a in runs[0] if a.failed][:2]
    assert list(curves([a.signals for a in few], np.array([a.failed for a in few]))["distance"]) == ["success"]


def test_a_ring_is_recorded_from_the_command_line(hardcase, tmp_path):
    path = tmp_path / "pick.mcap"
    code, out, err = hardcase("record", path, "--ring", "--seconds", 1, "--json")
    told = json.loads(out)
    assert (code, told["windows"], told["episode"]["frames"], told["episode"]["control_hz"]) == (0, [], 2, 2.0), err
    assert [p.name for p in tmp_path.iterdir()] == ["pick.mcap"]
