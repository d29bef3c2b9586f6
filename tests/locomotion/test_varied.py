"""Robots of a training that differ from each other."""

import numpy as np
import pytest

from pipeline.locomotion.robots import LeggedRobots, Quirks
from pipeline.locomotion.scenes import legged_scenes, starts_of
from pipeline.locomotion.tasks import BALANCE
from pipeline.locomotion.varied import RANGES, VariedWorld, vary
from pipeline.locomotion.world import LeggedWorld
from schemas.scene import Draw

SCENES = legged_scenes("balance", "biped", "study", [(k, "leaning") for k in range(3)])
ACTIONS = np.random.default_rng(0).normal(0, 0.4, (12, 3, 10))


def drawn(**values: float) -> list[list[Draw]]:
    return [[Draw(name=name, unit=RANGES[name][0], value=value) for name, value in values.items()]] * 3


def played(world, body) -> np.ndarray:
    world.restart(np.arange(3), starts_of(SCENES, body))
    for action in ACTIONS:
        world.act(action)
    return world.batch.state.copy()


def test_a_robot_of_which_nothing_is_drawn_is_the_nominal_one(body):
    assert np.array_equal(played(VariedWorld(body, BALANCE, [[]] * 3, seed=0), body),
                          played(LeggedWorld(body, BALANCE, 3), body))


@pytest.mark.parametrize("steps", [1, 3, 4, 6], ids=["part of a tick", "most of one", "a whole one", "more than one"])
def test_motors_that_hear_late_are_as_late_as_those_of_the_robots_at_work(body, steps):
    late = VariedWorld(body, BALANCE, drawn(delay_s=steps / 200), seed=0)
    robots = LeggedRobots(body, BALANCE, SCENES, quirks=Quirks(delay_steps=steps))
    for action in ACTIONS:
        robots.act(action, np.arange(3))
    assert np.array_equal(played(late, body), robots.batch.state)


@pytest.mark.parametrize(("name", "value"), [("payload", 0.2), ("strength", 0.3), ("stiffness", 0.5), ("damping", 4.0),
                                             ("ground", 0.05)])
def test_whatever_differs_changes_how_a_robot_moves(body, name, value):
    nominal = played(VariedWorld(body, BALANCE, [[]] * 3, seed=0), body)
    assert not np.allclose(played(VariedWorld(body, BALANCE, drawn(**{name: value}), seed=0), body), nominal)


def test_noise_is_what_the_sensors_are_said_to_have_and_no_truth_changes(body):
    world, clean = VariedWorld(body, BALANCE, drawn(noise=1.0), seed=5), LeggedWorld(body, BALANCE, 3)
    for each in (world, clean):
        each.restart(np.arange(3), starts_of(SCENES, body))
    apart = []
    for _ in range(60):
        apart.append(world.observe() - clean.observe())
        for each in (world, clean):
            each.act(np.zeros((3, 10)))
    assert np.array_equal(world.batch.state, clean.batch.state)
    spread = np.std(apart, axis=(0, 1))
    assert np.allclose(spread[:3], 0.25 * 0.03, rtol=0.3)
    assert np.allclose(spread[6:16], 0.0015, rtol=0.3)
    assert np.allclose(spread[26:], 0, atol=1e-7)  # the action and the command are known


def test_draws_stay_in_their_ranges_and_are_nominal_without_width():
    many = [vary(np.random.default_rng(k)) for k in range(200)]
    for k, (name, (unit, _, low, high)) in enumerate(RANGES.items()):
        values = [draws[k].value for draws in many]
        assert {(draws[k].name, draws[k].unit) for draws in many} == {(name, unit)}
        assert low <= min(values) < max(values) <= high
    assert [d.value for d in vary(np.random.default_rng(0), 0.0)] == [nominal for _, nominal, _, _ in RANGES.values()]
