from itertools import combinations

import numpy as np
import pytest

from pipeline.simulation.evaluation import gate_scenes
from pipeline.simulation.tasks import load_task
from stages.deploy import deploy_scenes
from stages.exam import exam, exam_scenes, success_by

pytestmark = pytest.mark.xdist_group("stages")


@pytest.fixture(scope="module")
def sat(policy, learnt, recipe, seed, twin):
    return exam(policy(learnt.champion), recipe, seed=seed, twin=twin)


def test_a_policy_that_sits_its_exam_again_gets_the_same_marks(sat, policy, learnt, recipe, seed, twin, same_bits):
    used = policy(learnt.champion)
    exam(used, recipe, seed=seed + 1, twin=twin)  # what it remembers of other attempts must not matter
    again = exam(used, recipe, seed=seed, twin=twin)
    assert same_bits(again.success, sat.success)
    assert again.strata == sat.strata
    assert all(same_bits(again.rewards[name], curve) for name, curve in sat.rewards.items())


def test_the_exam_holds_the_common_and_rare_starts_that_the_recipe_says(recipe, seed, twin):
    scenes, rare = exam_scenes(recipe, seed=seed, twin=twin), load_task(recipe.task).rare
    assert sum(s.stratum not in rare for s in scenes) == recipe.exam.common
    assert sum(s.stratum in rare for s in scenes) == recipe.exam.rare
    assert {s.twin for s in scenes} == {twin}


def test_the_mix_weighs_strata_as_they_are_met_at_work(sat, recipe):
    success, task = success_by(sat.success, sat.strata, recipe), load_task(recipe.task)
    share = recipe.deploy.rare_share
    rare = sum(success[name].rate * part for name, part in task.rare.items())
    assert success["deployment_mix"].rate == pytest.approx((1 - share) * success["common"].rate + share * rare)
    assert success["all"].successes == sat.success.sum()
    assert success["all"].n == success["common"].n + success["rare"].n == len(sat.success)


def test_every_reward_term_has_a_curve(sat, recipe):
    assert set(sat.rewards) == set(load_task(recipe.task).weights)
    assert all(np.isfinite(curve[0]) for curve in sat.rewards.values())


def test_families_of_seeds_never_overlap(recipe, twin, demonstrations, variants):
    seeds: dict[str, list[int]] = {"demo": [r.episode.scene.seed for r in demonstrations],
                                   "augment": [e.scene.seed for e in variants.episodes]}
    for run in range(4):
        seeds.setdefault("exam", []).extend(s.seed for s in exam_scenes(recipe, seed=run, twin=twin))
        for generation in range(4):
            seeds.setdefault("deploy", []).extend(
                s.seed for s in deploy_scenes(recipe, seed=run, twin=twin, generation=generation))
            seeds.setdefault("gate", []).extend(s.seed for s in gate_scenes(
                recipe.task, recipe.robot, recipe.scene, seed=run, generation=generation, start=0, stop=100,
                rare=["beside", "large"], rare_share=0.3))
    assert all(len(found) == len(set(found)) for found in seeds.values())
    for one, other in combinations(seeds, 2):
        assert not set(seeds[one]) & set(seeds[other]), f"{one} and {other} share a seed"


def test_gate_scenes_do_not_depend_on_how_many_looks_were_taken(recipe):
    def scenes(start, stop):
        return gate_scenes(recipe.task, recipe.robot, recipe.scene, seed=1, generation=2, start=start, stop=stop,
                           rare=["beside"], rare_share=0.3)

    assert scenes(0, 20) + scenes(20, 50) == scenes(0, 50)
    assert sum(s.stratum == "beside" for s in scenes(0, 50)) == 15
    assert all(s.draws and s.twin is None for s in scenes(0, 50))
