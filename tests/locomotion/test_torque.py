"""Torque control without stiffness: what H1's motors do by themselves, and what its training has of its own."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from flows.rl.order import order_of
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.starts import draw_start
from pipeline.locomotion.tasks import STAND, Pushes, Starts
from pipeline.locomotion.torque import holding_torques
from pipeline.locomotion.world import LeggedWorld
from pipeline.ppo.config import PpoConfig
from pipeline.ppo.suited import Suited

STORK = """
<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint/>
  <geom type="box" pos="{ahead} 0 0" size=".1 .1 .1" mass="3"/>
  <body name="leg"><joint name="hip" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.9" size=".03" mass="1"/>
  </body></body></worldbody>
  <actuator><motor joint="hip" ctrlrange="-20 20"/></actuator></mujoco>
"""
FROM_HOME = STAND.model_copy(update={"starts": {"home": Starts()}, "pushes": Pushes(), "seconds": 0.3})
TINY = PpoConfig(steps=512, attempts=16, ticks=8, batch=64, epochs=1, hidden=(8,))


@pytest.fixture
def h1(menagerie):
    return load_legged("unitree_h1")


def at_home(body, rates=None) -> LeggedWorld:
    world, start = LeggedWorld(body, FROM_HOME, 1), draw_start(FROM_HOME, body, "home", 0)
    world.restart(np.array([0]), [replace(start, rates=rates)])
    return world


@pytest.mark.parametrize("ahead", [0.0, 0.1, -0.05])
def test_a_hip_at_rest_bears_the_weight_ahead_of_it(ahead):
    spec = mujoco.MjSpec.from_string(STORK.format(ahead=ahead))
    ground_pushes_up_at = 3 * ahead / 4  # below the centre of mass
    (torque,) = holding_torques(spec, ("hip",), (0.0,), 1.0, ("leg",))
    assert torque == pytest.approx(4 * 9.81 * ground_pushes_up_at, abs=1e-6)


def test_h1_holds_its_posture_by_its_torques_at_rest_and_sinks_without(h1):
    bent = {}
    for name, body in {"held": h1, "slack": replace(h1, rest=None)}.items():
        world = at_home(body)
        for _ in range(FROM_HOME.ticks):
            world.act(np.zeros((1, 19)))
        bent[name] = float(np.abs(world.motion().joints).max())
    assert bent["held"] < 0.1 < 0.3 < bent["slack"]


@pytest.mark.parametrize(("speed", "asked", "torque"), [
    (2.0, 0.0, -4.0), (-2.0, 0.0, 4.0), (0.0, 1.0, 10.8), (200.0, 0.0, -18.0),
], ids=["brakes", "either way", "gives what is asked", "never beyond its limit"])
def test_a_motor_brakes_within_its_limit_and_has_no_stiffness(h1, speed, asked, torque):
    elbow = np.eye(19)[h1.joints.index("left_elbow")]  # a motor of 18 N m
    free, task = replace(h1, rest=None), FROM_HOME.model_copy(update={"substeps": 1, "control_hz": 1000.0})
    home = draw_start(task, free, "home", 0)
    world = LeggedWorld(free, task, 1)
    world.restart(np.array([0]), [replace(home, rates=speed * elbow, bend=0.3 * elbow)])
    world.act(asked * elbow[None])
    assert 18 * world.motion().effort[0] @ elbow == pytest.approx(torque, abs=0.3)


def test_only_h1_trains_by_numbers_of_its_own(menagerie, tmp_path):
    h1, biped = order_of("unitree_h1", "stand", 0), order_of("biped", "stand", 0)
    assert (h1.task.fallen_rad, h1.task.fallen_height) == (0.6, 0.75)
    assert h1.ppo.steps > biped.ppo.steps
    assert biped.task == STAND
    assert order_of("unitree_h1", "stand", 0, given={"steps": 7}).ppo.steps == 7
    own = tmp_path / "stand.yaml"
    own.write_text("instruction: Lean.\nstarts: {any: {}}\nfallen_rad: 0.9\nweights: {upright: 2.0}\n")
    assert order_of("unitree_h1", str(own), 0).task.fallen_rad == 0.9


def test_the_study_of_h1_has_both_baselines_and_its_own_kind_of_start(menagerie, monkeypatch, tmp_path):
    from flows.studies.stand import run_stand_study

    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path))
    monkeypatch.setattr("flows.rl.order.SUITED", {("stand", "unitree_h1"): Suited(TINY, {"fallen_rad": 0.6})})
    monkeypatch.setattr("flows.studies.legged.ATTEMPTS", 6)
    found = run_stand_study(seeds=1, body="unitree_h1", json=tmp_path / "stand.json")
    (row,) = found["rows"]
    assert (found["trained_on"], row["order"]["stratum"]) == ("leaning", "leaning")
    for stratum in ("leaning", "thrown"):
        assert row["arms"][stratum]["zero action"]["rate"] == 0
        assert list(found["pooled"][stratum]["rate"]) == ["policy", "zero action", "random action"]
