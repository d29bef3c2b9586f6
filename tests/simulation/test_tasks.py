"""Starts: each in its stratum, each family with seeds of its own, and all of them solvable."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import ConfigError
from pipeline.simulation.expert import Expert
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import FAMILY_BASE, TASKS, mixed_strata, sample_scene, scene_seed

TASK = TASKS["pick-place"]
families = st.sampled_from(sorted(FAMILY_BASE))
words = st.lists(st.integers(0, 2**40), min_size=1, max_size=4)


@given(families, words, st.sampled_from(sorted(TASK.strata)))
def test_a_start_lies_in_its_stratum_with_the_target_away(family, parts, stratum):
    scene = sample_scene("pick-place", family, scene_seed(family, *parts), stratum)
    kind, (x, y), (tx, ty) = TASK.strata[stratum], scene.object_xy_m, scene.target_xy_m
    assert kind.x_m[0] <= x <= kind.x_m[1]
    assert kind.y_abs_m[0] <= abs(y) <= kind.y_abs_m[1]
    assert kind.yaw_rad[0] <= scene.object_yaw_rad <= kind.yaw_rad[1]
    assert scene.object_half_m == kind.half_m
    assert TASK.target_x_m[0] <= tx <= TASK.target_x_m[1]
    assert TASK.target_y_m[0] <= ty <= TASK.target_y_m[1]
    assert np.hypot(tx - x, ty - y) >= TASK.target_away_m
    assert scene == sample_scene("pick-place", family, scene_seed(family, *parts), stratum)


@given(families, families, words, words)
def test_two_families_never_share_a_seed(one, other, parts, more):
    seed, another = scene_seed(one, *parts), scene_seed(other, *more)
    assert 0 <= seed < 2**63
    assert one == other or seed != another


def test_seeds_of_a_family_do_not_repeat():
    seeds = {scene_seed("exam", run, i) for run in range(20) for i in range(500)}
    assert len(seeds) == 10_000


def test_the_rare_strata_do_not_touch_the_common_one():
    common, beside = TASK.strata["common"], TASK.strata["beside"]
    assert beside.y_abs_m[0] > common.y_abs_m[1]
    assert TASK.strata["large"].half_m > common.half_m
    assert sum(TASK.rare.values()) == pytest.approx(1)


@settings(max_examples=50)
@given(st.integers(1, 400), st.floats(0, 1), st.integers(0, 2**32))
def test_the_mix_holds_exactly_the_rounded_rare_share(n, share, seed):
    names = mixed_strata("pick-place", n, share, np.random.default_rng(seed))
    rare = [name for name in names if name in TASK.rare]
    assert len(names) == n
    assert len(rare) == round(n * share)
    for name, part in TASK.rare.items():
        assert abs(rare.count(name) - part * len(rare)) <= 1


@pytest.mark.parametrize("stratum", TASK.strata)
def test_the_expert_solves_nearly_every_nominal_start(make_world, starts, stratum):
    world, expert = make_world(starts(64, stratum)), Expert()
    expert.reset(world.n)
    assert rollout(world, expert).success.sum() >= 60


def test_an_unknown_stratum_lists_every_valid_one():
    with pytest.raises(ConfigError, match="mend: use one of: beside, common, large"):
        sample_scene("pick-place", "demo", 1, "tiny")
