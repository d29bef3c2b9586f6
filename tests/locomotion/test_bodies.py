"""Bodies by name and by file: the humanoids of Menagerie, a robot of one's own, and files that are none."""

import sys

import numpy as np
import pytest

from pipeline.errors import ConfigError, SimulationError
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.evaluation import evaluate, zero_action
from pipeline.locomotion.rewards import REWARDS
from pipeline.locomotion.starts import draw_start
from pipeline.locomotion.tasks import STAND, Pushes, Starts, load_legged_task
from pipeline.locomotion.world import LeggedWorld

HOPPER = """
<mujoco><worldbody><geom type="plane" size="1 1 1"/>
  <body name="trunk" pos="0 0 .5"><freejoint/><geom type="box" size=".1 .1 .1" mass="3"/>
  <body name="leg"><joint name="knee" axis="0 1 0" range="-1 1" limited="true"/><geom type="capsule"
    fromto="0 0 0 0 0 -.4" size=".03" mass="1"/></body></body></worldbody>
  <actuator><{kind} joint="knee" {words}/></actuator></mujoco>
"""

@pytest.mark.parametrize(("name", "joints", "control"), [("unitree_h1", 19, "torque"), ("unitree_g1", 29, "position")])
def test_a_humanoid_of_menagerie_stands_on_its_feet_at_home(menagerie, name, joints, control):
    body = load_legged(name)
    assert (len(body.joints), body.control) == (joints, control)
    home = STAND.model_copy(update={"starts": {"home": Starts()}, "pushes": Pushes(), "seconds": 0.06})
    world = LeggedWorld(body, home, 1)
    world.restart(np.array([0]), [draw_start(home, body, "home", 0)])
    for _ in range(home.ticks):
        world.act(np.zeros((1, joints)))
    now = world.motion()
    assert now.contact.all()
    assert now.height[0] == pytest.approx(1, abs=0.05)


def test_h1_under_torque_falls_where_nobody_acts(menagerie):
    assert not evaluate(zero_action(19), load_legged("unitree_h1"), STAND, n=10).full.any()


def test_menagerie_missing_tells_where_to_put_it(monkeypatch, tmp_path):
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path / "nowhere"))
    with pytest.raises(SimulationError, match=r"unitree_h1 is not at hand.*\n.*\n  mend: .*set MENAGERIE_ROOT to a"):
        load_legged("unitree_h1")
    assert "mujoco_menagerie" in sys.modules


@pytest.mark.parametrize(("kind", "words", "control"), [
    ("position", 'kp="30" forcerange="-20 20"', "position"), ("motor", 'ctrlrange="-20 20" gear="1"', "torque"),
], ids=["servos", "motors"])
def test_a_file_of_ones_own_becomes_a_body(tmp_path, kind, words, control):
    path = tmp_path / "hopper.xml"
    path.write_text(HOPPER.format(kind=kind, words=words))
    body = load_legged(str(path))
    assert (body.root, body.joints, body.feet, body.control) == ("trunk", ("knee",), ("leg",), control)
    assert body.height_m == pytest.approx(0.43, abs=1e-6)  # the leg and the radius of its end
    assert 0 < evaluate(zero_action(1), body, STAND, n=3).length.mean() < STAND.ticks


def test_a_urdf_floats_and_has_a_motor_for_every_effort(tmp_path, strider_urdf):
    path = tmp_path / "strider.urdf"
    path.write_text(strider_urdf)
    body = load_legged(str(path))
    assert (body.root, body.joints, body.feet, body.control) == ("trunk", ("hip",), ("leg",), "torque")
    assert body.height_m == pytest.approx(0.4)
    world = LeggedWorld(body, STAND, 2)
    world.restart(np.arange(2), [draw_start(STAND, body, "leaning", k) for k in range(2)])
    world.act(np.array([[1.0], [0.0]]))
    assert world.motion().effort[:, 0] == pytest.approx([body.scale, 0.0])  # shares of the 30 N m that the file allows


@pytest.mark.parametrize(("text", "told", "mend"), [
    ("<mujoco>", "model does not load", "meshes lie where it says"),
    ('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>', "0 floating bodies", "a free joint"),
], ids=["not whole", "nothing floats"])
def test_a_file_that_is_no_robot_says_what_it_lacks(tmp_path, text, told, mend):
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(SimulationError, match=rf"{told}.*\n.*robot.xml\n  mend: .*{mend}"):
        load_legged(str(path))


def test_a_task_of_ones_own_is_a_file(tmp_path):
    path = tmp_path / "lean.yaml"
    path.write_text("instruction: Lean.\nstarts: {any: {tilt_rad: 0.1}}\nweights: {upright: 2.0}\n")
    task = load_legged_task(str(path))
    assert (task.weights, task.starts["any"].tilt_rad) == ({"upright": 2.0}, 0.1)


@pytest.mark.parametrize(("line", "mend"), [
    ("weights: {uprigth: 1.0}", "use one of: .*upright"),
    (f"weights: {dict.fromkeys(list(REWARDS)[:6], 1.0)}", "fields: "),
    ("weight: {upright: 1.0}", "use one of: .*weights"),
    ("weights: {upright: .nan}", "fields: "),
], ids=["unknown term", "six terms", "unknown field", "not a number"])
def test_a_wrong_task_file_is_refused_in_one_line(tmp_path, line, mend):
    path = tmp_path / "lean.yaml"
    path.write_text(f"instruction: Lean.\nstarts: {{any: {{}}}}\n{line}\n")
    with pytest.raises(ConfigError, match=f"mend: {mend}"):
        load_legged_task(str(path))
