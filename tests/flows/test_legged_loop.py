"""The loop of a legged robot: falls become starts, and everything that a loop promises holds for it, too."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flows.data.checking import check_all
from flows.data.version_table import versions
from flows.run.arms import LOOP
from flows.run.mining_told import mine_run
from flows.run.shadow_report import judge_candidate
from flows.run.steps import open_run
from flows.run.worth import run_worth
from flows.run.worth_batch import Order
from flows.service.estimate import turn_steps
from flows.studies.falls import pool, shares_of, tables
from pipeline.errors import ConfigError, DatasetError, HardcaseError
from pipeline.files import sha256_file
from pipeline.lerobot_view.erasing import Loss, erase
from pipeline.lerobot_view.manifest import load_version
from pipeline.lerobot_view.opened import open_version
from pipeline.locomotion.gating import legged_gate_scenes
from pipeline.locomotion.lesson import Lesson
from pipeline.recipes import load_recipe
from pipeline.store import Store
from pipeline.store.lineage import why
from schemas.counterfactual import JudgeConfig

ROOT = Path(__file__).parents[2]
RECIPE = load_recipe("biped-smoke")


def silent(done: int, total: int) -> None:
    pass


@pytest.fixture(scope="module")
def turned(tmp_path_factory) -> Path:
    """A loop and its control, turned to their ends; the store they lie in."""
    root = tmp_path_factory.mktemp("legged") / "store"
    with open_run(root, RECIPE, seed=0, twin=3, control=True) as loop:
        for steps in (loop, loop.control):
            for step in turn_steps("", RECIPE.generations, RECIPE):
                getattr(steps, step.stage)(step.generation, silent)
        loop.judge(1, silent)
        loop.worth(1, silent)
        loop.report(silent)
    return root


@pytest.fixture
def loop(turned):
    with open_run(turned, RECIPE, seed=0, twin=3, control=True) as steps:
        yield steps


def lesson_of(steps, generation: int) -> Lesson:
    return Lesson.read(steps.store.path(steps.material.version(generation).path))


def test_every_fall_becomes_a_start_of_the_next_training_or_of_its_gate(loop):
    fell = [e for e in loop.store.episodes(loop.material.ids(0, "deploy")) if e.outcome.label == "failure"]
    cases = loop.store.hard_cases(run=loop.run)
    assert {c.episode for c in cases} == {e.id for e in fell}
    assert all(c.start is not None and (c.begins or 0) < c.tick for c in cases)
    first, second = lesson_of(loop, 0), lesson_of(loop, 1)
    assert (first.curriculum.starts, first.curriculum.hard_share) == ((), 0.0)
    taught = {s.case: s.start for s in second.curriculum.starts}
    held = {s.case: s.start for s in second.held_out}
    assert taught | held == {c.id: c.start for c in cases}
    assert not taught.keys() & held.keys()
    assert second.curriculum.hard_share == RECIPE.rl.hard_share
    assert list(second.curriculum.kinds) == ["leaning"]  # rare kinds are met at work alone


def test_a_lap_goes_on_from_the_champion_and_says_so(loop):
    first, second = loop.candidate(0), loop.candidate(1)
    told = why(loop.store, second)
    assert told.facts["went on from"] == f"policy {first}"
    version = next(c for c in told.children if c.kind == "version")
    assert version.facts["hard cases"].startswith(f"{len(loop.store.hard_cases(run=loop.run))}: ")
    assert any("recordings" in group.facts for group in version.children)
    case = loop.store.hard_cases(run=loop.run)[0]
    assert version.id in {id for used in why(loop.store, case.id).used_by for id in used.ids}
    record = loop.store.policy(second)
    assert (record.kind, record.steps) == ("ppo", RECIPE.rl.lap_steps)
    assert record.files.keys() == {"policy.onnx", "weights.safetensors", "training.json"}


def test_the_control_trains_as_long_at_drawn_starts_and_shares_generation_0(loop):
    control = loop.control
    assert control.candidate(0) == loop.candidate(0)
    assert lesson_of(control, 1).curriculum.starts == ()
    ours, theirs = loop.store.policy(loop.candidate(1)), loop.store.policy(control.candidate(1))
    assert ours.id != theirs.id
    assert ours.steps == theirs.steps
    assert control.robot_seconds(0) == 0 < loop.robot_seconds(0)


def test_the_gate_plays_falls_that_no_training_meets_on_robots_that_differ(loop):
    lesson = lesson_of(loop, 1)
    held = lesson.held_out or lesson.curriculum.starts
    scenes = legged_gate_scenes(RECIPE.task, RECIPE.robot, seed=0, generation=1, start=0, stop=8, hard=held,
                                hard_share=0.5, widen=1.0)
    assert [s.stratum for s in scenes].count("hard") == 4
    assert len({s.draws for s in scenes}) == 8
    assert all(s.family == "gate" and s.twin is None for s in scenes)
    again = legged_gate_scenes(RECIPE.task, RECIPE.robot, seed=0, generation=1, start=4, stop=8, hard=held,
                               hard_share=0.5, widen=1.0)
    assert again == scenes[4:]
    near = next(s.legged for s in scenes if s.stratum == "hard")
    assert np.abs(np.subtract(near.bend, held[0].start.bend)).max() < 0.5


def test_nothing_that_is_finished_is_done_again(loop):
    for step in turn_steps("", RECIPE.generations, RECIPE):
        assert getattr(loop, step.stage)(step.generation, silent).resumed


def test_a_curriculum_that_was_killed_is_the_same_when_it_is_made_again(loop, turned, tmp_path):
    with open_run(tmp_path / "store", RECIPE, seed=0, twin=3, control=False) as other:
        for stage in ("collect", "augment", "build"):
            getattr(other, stage)(0, silent)
        assert other.material.version(0) == loop.material.version(0)


def test_the_result_and_the_page_tell_of_falls(loop):
    result = loop.result()
    assert [g.generation for g in result.generations] == [0, 1]
    assert result.control is not None
    assert set(result.generations[0].success) == {"all", "common", "rare", "deployment_mix"}
    page = loop.report_path().read_text(encoding="utf-8")
    for words in ("PPO, every candidate", "Full attempts", "Upright", "A fall is noticed from what the robot senses"):
        assert words in page
    assert "Behaviour cloning" not in page


def test_versions_of_starts_are_listed_and_forgotten_like_others(loop, turned, tmp_path):
    rows = versions(turned)
    assert "curriculum of drawn starts" in rows[0]["sources"]
    assert sum(n for kind, n in rows[1]["sources"].items() if kind.startswith("starts of falls")) == rows[1]["episodes"]
    version = loop.material.version(1)
    lesson = lesson_of(loop, 1)
    folder = tmp_path / "versions" / version.id
    lesson.write(folder, {"format": "hardcase-version-1", "version": version.model_dump(mode="json",
                                                                                       exclude={"digest"})},
                 aside=tmp_path / "tmp")
    gone = lesson.curriculum.starts[0]
    blob = str(loop.store.episode(gone.episode).blob)
    left = erase(folder, Loss(frozenset({gone.episode}), frozenset({blob}), {}), tmp_path / "aside")
    assert left == load_version(folder)
    assert left.erased == (gone.episode,)
    text = (folder / "curriculum.json").read_text() + (folder / "meta" / "hardcase.json").read_text()
    assert gone.case not in text
    assert blob not in text
    with pytest.raises(DatasetError, match="is incomplete: erased"):
        Lesson.load(folder)


@pytest.mark.parametrize(("refused", "mend"), [
    (lambda root, _: mine_run(root, None, None, film=False), "hardcase why POLICY"),
    (lambda root, _: judge_candidate(root, "0" * 16, run=None, generation=None, config=JudgeConfig(), keep=False),
     "hardcase loop --control"),
    (lambda root, version: open_version(root / version.path, version), "name a version of frames"),
    (lambda root, version: run_worth(Order(batch=version.id), as_json=False), "name a version of frames"),
    (lambda root, version: check_all([version.id], contract=None, out=None), "these starts come from: hardcase why"),
], ids=["mine", "judge", "derive and export", "worth", "check"])
def test_what_needs_frames_or_corrections_refuses_with_the_mend(turned, refused, mend, monkeypatch):
    monkeypatch.setenv("HARDCASE_STORE", str(turned))
    with Store.open(turned) as store:
        newest = store.versions()[-1]
    with pytest.raises(HardcaseError) as error:
        refused(turned, newest)
    assert mend in error.value.mend


@pytest.mark.parametrize(("wrong", "told"), [
    ({"robot": "arm"}, "use one of: biped"), ({"task": "pick-place"}, "use one of: balance"),
    ({"scene": "table"}, "use one of: ground"),
    ({"train": RECIPE.train.model_copy(update={"policy": "chunked"})}, "use one of: ppo"),
], ids=["robot", "task", "scene", "policy"])
def test_a_recipe_of_a_legged_robot_names_what_legged_robots_have(wrong, told):
    from flows.run.opening import check_names

    with pytest.raises(ConfigError, match=told):
        check_names(RECIPE.model_copy(update=wrong))


def test_a_loop_killed_within_a_training_goes_on_to_the_same_policy(loop, tmp_path):
    root = tmp_path / "store"
    code = ("import pathlib; from flows.run.steps import open_run; from pipeline.recipes import load_recipe\n"
            f"root, recipe = pathlib.Path({str(root)!r}), load_recipe('biped-smoke')\n"
            "with open_run(root, recipe, seed=0, twin=3, control=False) as steps:\n"
            "    steps.train(0, lambda done, _: print(done, flush=True) or (done >= 1536 and input()))")
    child = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert child.stdout is not None
    while int(child.stdout.readline()) < 1536:
        pass
    child.send_signal(signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    assert list((root / "policies").glob(".*.training/step-*"))  # it goes on from there
    with open_run(root, RECIPE, seed=0, twin=3, control=False) as steps:
        steps.train(0, silent)
        ours = steps.store.path(steps.store.policy(steps.candidate(0)).checkpoint) / "weights.safetensors"
    theirs = loop.store.path(loop.store.policy(loop.candidate(0)).checkpoint) / "weights.safetensors"
    assert sha256_file(ours) == sha256_file(theirs)


def test_a_study_tells_falls_lap_by_lap_beside_the_control(turned, loop, tmp_path):
    folder = tmp_path / "study"
    folder.mkdir()
    laps = [{"generation": g, "decision": "PASS", "strata": ["leaning"] * 4 + ["hurled", "deep"],
             "champion": bits, "candidate": bits} for g, bits in enumerate(("110010", "111110"))]
    control = [laps[0], laps[0] | {"generation": 1}]
    seeds = [{"seed": k, "arms": {LOOP: {"laps": laps}, "random": {"laps": control}}} for k in range(2)]
    found = pool(seeds, RECIPE)["champion"]
    mix, rare = shares_of(RECIPE)
    assert sum(mix.values()) == pytest.approx(1)
    assert rare == {"hurled": 0.5, "deep": 0.5}
    before, after = mix["leaning"] * 0.5 + mix["deep"], mix["deep"]
    assert found["falls"]["loop"] == [[pytest.approx(before)] * 2, [pytest.approx(after)] * 2]
    assert found["fewer_than_control"][1]["estimate"] == pytest.approx(before - after)
    assert found["seeds_won"] == [2, 2]
    assert tables(seeds, pool(seeds, RECIPE), RECIPE).renderables
    json.dumps(found)
