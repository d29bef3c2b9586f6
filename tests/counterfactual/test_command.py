"""`hardcase judge` as people type it, on a small loop that was really turned."""

import json
import re

import pytest

from flows.run.steps import open_run
from pipeline.store import Store
from schemas.counterfactual import JudgeConfig, ShadowReport
from schemas.recipe import (
    AugmentConfig,
    CollectConfig,
    DeployConfig,
    ExamConfig,
    GateConfig,
    HarvestConfig,
    Recipe,
    TrainConfig,
)

SMALL = Recipe(
    name="small", generations=1, threads=1, collect=CollectConfig(demonstrations=4),
    augment=AugmentConfig(replays=4, retargets=0, per_correction=1),
    train=TrainConfig(steps=4, batch=8, width=8, checkpoint_every=4),
    gate=GateConfig(looks=(4,), bootstrap_success=0.0), deploy=DeployConfig(episodes=3, shadow=False),
    harvest=HarvestConfig(corrections=2, judge=JudgeConfig(draws=4, most=3, checked=1, threshold=0.001, lasting=1)),
    exam=ExamConfig(common=1, rare=1))


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """Store, run and policies of a loop whose second harvest corrects what was judged."""
    root = tmp_path_factory.mktemp("turned")
    with open_run(root, SMALL, seed=0, twin=4, control=False) as steps:
        for generation in range(2):
            for stage in ("collect", "augment", "build", "train", "gate", "release", "exam", "deploy", "harvest"):
                if generation == 0 or stage != "collect":
                    getattr(steps, stage)(generation, lambda done, total: None)
        return root, steps.run, [p.id for p in steps.store.policies()]


@pytest.fixture
def judge(turned, hardcase, monkeypatch):
    monkeypatch.setenv("HARDCASE_STORE", str(turned[0]))
    monkeypatch.setenv("COLUMNS", "120")
    return lambda *words: hardcase("judge", *words)


def champion_and_other(turned):
    root, run, policies = turned
    with Store.open(root) as store:
        champion = store.champion(run).policy
    return champion, next(p for p in policies if p != champion)


def test_a_loop_that_judges_corrects_only_where_somebody_was_wrong(turned):
    root, run, _ = turned
    with Store.open(root) as store:
        first, second = (store.hard_cases(run=run, generation=g) for g in (0, 1))
        assert first and all(c.judgement is None for c in first), "nobody to disagree with yet"
        assert second and all(c.judgement is not None and c.wrong for c in second)
        corrected = store.episodes([str(c.correction) for c in second if c.correction])
        assert {e.parent for e in corrected} <= {c.episode for c in second} and corrected


def test_the_command_prints_the_verdict_writes_its_files_and_keeps_the_cases_once(turned, judge, hardcase, tmp_path):
    champion, other = champion_and_other(turned)
    out = tmp_path / "report.json"
    words = (other[:8], "--draws", "4", "--checked", "2", "--threshold", "0.001", "--lasting", "1", "--keep")
    code, said, _ = judge(*words, "--json", out)
    report = ShadowReport.model_validate_json(out.read_text())
    assert code == 0 and (report.champion, report.candidate) == (champion, other)
    assert f"{report.verdict}: " in said and "hard cases (in the store)" in said
    page = turned[0] / "reports" / f"shadow-{turned[1]}-1-{other}.html"
    html = page.read_text()
    assert str(page) in said.replace("\n", "") and report.verdict in html and report.judgements[0].episode in html
    assert "http:" not in html and "https:" not in html and "<script" not in html
    with Store.open(turned[0]) as store:
        kept = [c for c in store.hard_cases(run=turned[1]) if c.judgement in report.judgements]
    assert {c.judgement.id for c in kept} == {j.id for j in report.judgements if j.wrong}
    assert judge(*words)[0] == 0
    with Store.open(turned[0]) as store:
        assert [c for c in store.hard_cases(run=turned[1]) if c.judgement in report.judgements] == kept
    code, told, _ = hardcase("why", kept[0].id)
    assert code == 0 and f"wrong: {kept[0].wrong}" in told and f"candidate: {other}, " in told
    assert f"attempt: episode {kept[0].episode}" in told
    assert json.loads(out.read_text())["verdict"] == report.verdict


def test_the_command_judges_from_sensors_alone_and_says_how_well_the_replay_fits(turned, judge, tmp_path):
    _, other = champion_and_other(turned)
    out = tmp_path / "estimated.json"
    code, said, _ = judge(other[:8], "--estimated", "--draws", "4", "--checked", "1", "--threshold", "0.001",
                          "--lasting", "1", "--json", out)
    report = ShadowReport.model_validate_json(out.read_text())
    assert code == 0 and report.estimated and report.judgements and all(j.estimated for j in report.judgements)
    first = sum(j.tick == 0 for j in report.judgements)
    assert f"estimated from sensors alone; {first} begin at the first tick" in said
    page = turned[0] / "reports" / f"shadow-{turned[1]}-1-{other}-estimated.html"
    assert "estimated shadow report" in page.read_text() and "estimated from what the robot sensed" in page.read_text()


@pytest.mark.parametrize(("words", "what", "mend"), [
    (("0123456789abcdef",), "0123456789abcdef", "mend: "),
    (("CHAMPION",), "was the champion itself in generation 1", "mend: name another: "),
    (("OTHER", "--generation", "7"), "generation 7 was not deployed", "mend: use one of --generation 0, 1"),
    (("OTHER", "--threshold", "-1"), "threshold = -1.0: ", "mend: see: hardcase judge --help"),
    (("OTHER", "--draws", "3"), "draws = 3: ", "mend: see: hardcase judge --help"),
    (("OTHER", "--run", "ffffffffffffffff"), "no run ffffffffffffffff", "mend: use one of: "),
], ids=["no such policy", "the champion", "a lap that is still to come", "below 0", "draws that decide nothing",
        "no such run"])
def test_bad_input_is_refused_with_its_mend(turned, judge, words, what, mend):
    champion, other = champion_and_other(turned)
    code, _, said = judge(*(w.replace("CHAMPION", champion).replace("OTHER", other) for w in words))
    assert code == 2 and what in said and mend in said and "Traceback" not in said
    assert re.search(r"\n  at:   .+\n  mend: .+", said)


def test_a_store_without_a_deployment_says_what_to_run(hardcase, monkeypatch, tmp_path):
    with open_run(tmp_path, SMALL, seed=1, twin=4, control=False) as steps:
        steps.collect(0, lambda done, total: None)
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path))
    code, _, said = hardcase("judge", "0123456789abcdef")
    assert code == 2 and "mend: " in said
