"""Twins: one seed, one robot; many of them beyond what training can draw."""

import numpy as np
import pytest

from pipeline.errors import ConfigError
from pipeline.simulation.expert import Expert
from pipeline.simulation.physics import MAX_DELAY, NOMINAL, RANDOMIZATIONS, UNITS
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.twin.twin import draw_twin, twin_setup, twin_world

TWINS = [draw_twin(seed) for seed in range(200)]


def training_ranges() -> dict[str, tuple[float, float]]:
    """Smallest and largest of 5,000 training draws of each parameter."""
    rng = np.random.default_rng(0)
    drawn = {name: [draw(rng, 1.0) for _ in range(5000)] for name, draw in RANDOMIZATIONS.items()}
    return {name: (min(values), max(values)) for name, values in drawn.items()}


def scenes(n: int, twin: int):
    return [sample_scene("pick-place", "deploy", scene_seed("deploy", i), "common", twin=twin) for i in range(n)]


def test_a_seed_gives_the_same_twin_again_and_other_seeds_others():
    assert [draw_twin(seed) for seed in range(200)] == TWINS
    assert len({twin.draws for twin in TWINS}) == 200


def test_a_third_of_the_twins_and_more_lie_outside_training():
    ranges = training_ranges()
    outside = [twin.outside(ranges) for twin in TWINS]
    assert sum(map(bool, outside)) >= 200 / 3
    parameters = [set(names) & RANDOMIZATIONS.keys() for names in outside]
    assert sum(map(bool, parameters)) >= 200 / 3  # not by structure alone


def test_some_twins_have_structure_that_training_lacks():
    stiction = [any(d.name == "stiction" for d in twin.draws) for twin in TWINS]
    flex = [twin.flex is not None for twin in TWINS]
    assert 0.2 < np.mean(stiction) < 0.6
    assert 0.2 < np.mean(flex) < 0.6
    assert any(np.array(stiction) & flex)


def test_every_twin_can_be_simulated():
    for twin in TWINS:
        drawn = {d.name: d.value for d in twin.draws}
        assert drawn.keys() <= NOMINAL.keys()
        assert all(d.unit == UNITS[d.name] for d in twin.draws)
        assert drawn["delay"] + 1 <= MAX_DELAY
        assert all(drawn[name] > 0 for name in ("kp", "damping", "friction", "mass"))


def test_the_same_commands_move_two_twins_differently_and_one_twin_alike():
    paths = []
    for seed in (3, 3, 4):
        world, expert = twin_world(TWINS[seed], scenes(3, seed), threads=1), Expert()
        expert.reset(3)
        rollout(world, expert, horizon=20)
        paths.append(world.observe(np.arange(3)).state)
    assert (paths[0] == paths[1]).all()
    assert not np.allclose(paths[0], paths[2], atol=1e-3)


def test_contacts_are_not_those_of_training():
    option = twin_setup(TWINS[0], "arm", "table").model.opt
    assert option.cone == 1
    assert option.impratio == pytest.approx(3.0)
    assert option.timestep == pytest.approx(0.005)


def test_the_expert_still_solves_most_attempts_on_the_twins():
    for seed in range(3):
        world, expert = twin_world(TWINS[seed], scenes(20, seed), threads=2), Expert()
        expert.reset(20)
        assert rollout(world, expert).success.mean() > 0.7


def test_there_is_no_twin_of_another_robot():
    with pytest.raises(ConfigError, match="mend: use robot: arm"):
        twin_setup(TWINS[0], "crane", "table")
