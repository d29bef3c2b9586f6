"""A loop that orders its corrections by value: families, queue, regression set, and the commands that tell of them."""

import json
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from flows.run.mining_told import mined_lap
from flows.run.regression import checked
from flows.run.steps import open_run
from pipeline.errors import ConfigError
from pipeline.mining.planted import PLANTED, fail
from pipeline.recipes import load_recipe
from pipeline.simulation.perceived import as_perceived
from pipeline.simulation.recordings import episode_id
from pipeline.store import Store
from pipeline.triggers import stratum_of
from schemas.mining import RegressionScene
from schemas.recipe import AugmentConfig, HarvestConfig, Recipe
from schemas.release import Release
from stages.augment import augment
from stages.harvest import choose, harvest
from stages.mine import chance_of

pytestmark = pytest.mark.xdist_group("mining")


def test_every_hard_case_of_the_loop_has_a_family_and_a_subtask(steps):
    cases, families = steps.store.hard_cases(run=steps.run), steps.store.families(run=steps.run)
    assert cases
    assert {c.found for c in cases} == {f.id for f in families}
    assert {f.medoid for f in families} <= {c.episode for c in cases}
    assert len({f.name for f in families}) == len(families)
    for case in cases:
        assert 0 <= case.begins <= case.tick


def test_the_loop_corrects_the_first_of_the_queue(steps):
    told = mined_lap(steps, 0, [])
    corrected = {c.id for c in steps.store.hard_cases(run=steps.run) if c.correction}
    assert {place.case for place in told.queue[:3]} == corrected


def test_mine_tells_families_queue_and_reasons(root, hardcase, monkeypatch, tmp_path):
    monkeypatch.setenv("HARDCASE_STORE", str(root))
    monkeypatch.setenv("COLUMNS", "250")
    code, out, _ = hardcase("mine", "--json", tmp_path / "mined.json")
    told = json.loads((tmp_path / "mined.json").read_text())
    assert code == 0
    assert all(f["new"] and f["name"] in out for f in told["families"])
    assert sum(f["failures"] for f in told["families"]) == len(told["cases"]) == len(told["queue"])
    worth = [place["worth"] for place in told["queue"]]
    assert worth[0] == max(worth)
    assert "of 14 attempts failed as" in told["queue"][0]["reason"]
    strips = [f["strip"] for f in told["families"]]
    assert all(Path(strip).read_bytes()[:4] in (b"RIFF", b"\x89PNG") for strip in strips)


def test_mining_again_gives_the_same_families(steps):
    stored = [(f.id, f.name) for f in steps.store.families(run=steps.run)]
    assert [(f.id, f.name) for f in mined_lap(steps, 0, []).new] == stored


@pytest.mark.parametrize("words", [("mine", "--generation", 7), ("mine", "--run", "feedfeedfeedfeed")])
def test_mine_refuses_what_was_never_deployed_in_one_line(root, hardcase, monkeypatch, words):
    monkeypatch.setenv("HARDCASE_STORE", str(root))
    code, _, err = hardcase(*words)
    assert code == 2
    assert "mend: use one of" in err
    assert "Traceback" not in err


@pytest.fixture(scope="module")
def kept(root) -> RegressionScene:
    """A scene of the loop's regression set, put there with the release that fixed it."""
    with open_run(root, load_recipe(str(root.parent / "mined.yaml")), seed=3, twin=4, control=False) as steps:
        old, new = steps.candidate(0), steps.candidate(1)
        case = next(c for c in steps.store.hard_cases(run=steps.run, corrected=True) if c.stratum != "common")
        episode = steps.store.episode(case.episode)
        scene = as_perceived(episode.scene, steps.material.frames(episode).environment[0])
        names = {f.id: f.name for f in steps.store.families(run=steps.run)}
        fixed = RegressionScene(id=episode_id("deployed", scene, "kept"), hard_case=case.id, episode=case.episode,
                                family=names[case.found], scene=scene, fixed_by=new, generation=1, solved=8, played=8)
        first = steps.store.champion(steps.run)
        with steps.store.commit(steps.lease, steps.run) as tx:
            tx.add_regression_scenes([fixed])
            tx.add_release(Release(number=2, policy=new, previous=old, verdict=first.verdict, kind="promotion",
                                   onnx=first.onnx))
    return fixed


def test_a_release_that_loses_a_fixed_scene_says_so_by_scene_and_family(steps, kept):
    assert checked(steps, 1, steps.candidate(0)).lost == (kept,)
    said = steps.rollback().says
    assert f"LOSES 1 of 1 regression scenes: {kept.family} {kept.id}" in said
    assert steps.store.champion(steps.run).lost == (kept.id,)
    assert steps.store.regression_scenes(run=steps.run) == [kept]


def test_a_regression_scene_knows_nothing_of_the_twin(steps):
    episode = steps.store.episodes(steps.material.ids(0, "deploy"))[0]
    seen = steps.material.frames(episode).environment[0]
    scene = as_perceived(episode.scene, seen)
    assert scene.twin is None
    assert scene.object_xy_m == (float(seen[0]), float(seen[1]))
    assert scene.object_xy_m != episode.scene.object_xy_m
    assert scene.stratum == stratum_of(seen)


def test_forgetting_an_attempt_takes_its_family_and_its_regression_scene_along(
        root, kept, hardcase, monkeypatch, tmp_path):
    copytree(root, tmp_path / "store")
    with Store.open(tmp_path / "store") as store:
        family = store.families()[0]
        assert store.regression_scenes() == [kept]
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    for episode in dict.fromkeys((kept.episode, family.medoid)):
        assert hardcase("forget", episode, "--reason", "asked for", "--yes")[0] == 0
    with Store.open(tmp_path / "store") as store:
        assert store.regression_scenes() == []
        assert family.id not in {f.id for f in store.families()}
    assert hardcase("mine")[0] == 0


def test_an_order_by_value_without_a_queue_is_refused_with_the_mend(steps):
    cases = steps.store.hard_cases(run=steps.run)
    with pytest.raises(ConfigError, match=r"mend: hand in the queue of stages\.mine"):
        choose(cases, HarvestConfig(order="value"))


def test_random_choice_is_the_same_every_time_and_differs_from_the_order_of_meeting(steps):
    cases = steps.store.hard_cases(run=steps.run)
    config = HarvestConfig(order="random", corrections=len(cases))
    assert choose(cases, config) == choose(cases[::-1], config)
    assert {c.id for c in choose(cases, config)} == {c.id for c in cases}


def test_recipes_that_name_no_order_keep_their_run_ids():
    plain = Recipe(name="plain")
    assert '"order"' not in plain.model_dump_json()
    assert '"aim"' not in plain.model_dump_json()
    assert '"order":"value"' in Recipe(name="plain", harvest=HarvestConfig(order="value")).model_dump_json()


def test_chance_follows_what_laps_have_shown():
    assert chance_of(0, 0) == 0.8
    assert chance_of(8, 0) < 0.2
    assert chance_of(8, 8) > 0.9


def test_a_correction_aimed_at_the_subtask_begins_where_that_began(steps, tmp_path):
    attempts, cases = steps.material.failed_attempts(0), steps.store.hard_cases(run=steps.run)
    config = steps.recipe.harvest.model_copy(update={"aim": "subtask", "order": "in-turn"})
    recipe = steps.recipe.model_copy(update={"harvest": config})
    plain = [c.model_copy(update={"correction": None, "corrected": False}) for c in cases]
    done = harvest(attempts, recipe, twin=steps.twin, generation=0, folder=tmp_path, software={}, judged=plain)
    assert len(done.recorded) == 3
    for case, made in zip(done.chosen, done.recorded, strict=True):
        own = next(s for s in made.episode.segments if s.kind == "intervention")
        assert own.start <= max(1, case.begins) + config.operator_delay_ticks
        assert own.start < case.tick


def test_variants_of_what_went_wrong_on_the_way_to_the_mark_have_their_mark_near_it(steps):
    demos = [(e, steps.material.frames(e)) for e in steps.material.fresh(0) if e.outcome.label == "success"]
    place = next((e, t.frames()) for e, t in steps.material.failed_attempts(0) if e.scene.stratum == "common")
    made = [augment(demos, AugmentConfig(), replays=0, retargets=12, seed=1, generation=1, threads=1, near=[place],
                    same_mark=kept).episodes for kept in ((), (place[0].id,))]
    mark = place[1].environment[0, 4:6]
    free, near = ([np.abs(np.subtract(e.scene.target_xy_m, mark)).max() < 0.0401 for e in side] for side in made)
    assert sum(near) >= 8  # the rest would have stood too close to the object
    assert sum(free) < sum(near) / 2
    assert [e.scene.object_xy_m for e in made[0]] == [e.scene.object_xy_m for e in made[1]]


def test_planted_causes_make_a_policy_fail(steps):
    scenes = [PLANTED["beside"](k) for k in range(4)]
    failed = fail(steps.policy(steps.candidate(0)), scenes, steps.recipe.harvest)
    assert len(failed) >= 3
    assert all(len(trace) > 1 and "-" in family for _, trace, family in failed)
