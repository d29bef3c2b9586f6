"""What legs tell of the base, on every robot: from box feet, capsules and spheres alike."""

import numpy as np
import pytest

from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.odometry import LegOdometry
from pipeline.locomotion.sensed import sensed
from pipeline.locomotion.starts import Start
from pipeline.locomotion.tasks import load_legged_task
from pipeline.locomotion.world import LeggedWorld


def standing(body, tilt=0.0, turning=(0.0, 0.0, 0.0), ids=1):
    """What a robot senses that stands in its home posture."""
    world = LeggedWorld(body, load_legged_task("stand"), ids)
    quaternion = np.array([np.cos(tilt / 2), 0, np.sin(tilt / 2), 0])
    world.restart(np.arange(ids), [Start(body.height_m, quaternion, np.array([0, 0, 0, *turning]),
                                         np.zeros(len(body.joints)), np.zeros(3), np.zeros((0, 3)))] * ids)
    return sensed(world.observe().astype(float), body)


@pytest.mark.parametrize("name", ["biped", "unitree_h1", "unitree_g1"])
def test_legs_tell_how_high_the_base_stands(name, request):
    if name != "biped":
        request.getfixturevalue("menagerie")
    body = load_legged(name)
    now, legs = standing(body), LegOdometry(body, 1)
    assert legs.height(now, np.arange(1))[0] == pytest.approx(body.height_m, abs=0.01)
    assert np.abs(legs.velocity(now)).max() < 1e-9


def test_a_base_that_tips_about_its_feet_goes_as_fast_as_it_is_high():
    body = load_legged("biped")
    now, legs = standing(body, turning=(0.0, 0.3, 0.0)), LegOdometry(body, 1)
    forward, left, _ = legs.velocity(now)
    assert 0.7 * 0.3 * body.height_m < forward < 0.3 * body.height_m and abs(left) < 1e-6


def test_what_is_asked_for_is_believed_where_the_feet_contradict_each_other():
    body = load_legged("biped")
    now, legs = standing(body, ids=3), LegOdometry(body, 3)
    asked = now.command.copy()
    asked[:, 0] = 0.4
    still = legs.velocity(now)
    now.command[:] = asked
    assert still[0] == pytest.approx(0, abs=1e-9)
    assert 0 < legs.velocity(now)[0] < 0.1, "three feet that agree weigh more than what was asked"
