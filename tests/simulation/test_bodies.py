"""Robot bodies: the reference arm, and any MJCF or URDF file in a scene."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from pipeline.errors import ConfigError, SimulationError
from pipeline.simulation.bodies import ARM, Flex, arm, from_file, load_body
from pipeline.simulation.model import compile_model, compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.tasks import load_task
from pipeline.simulation.urdf import robot_urdf
from pipeline.simulation.world import World

MENAGERIE = Path(os.environ.get("MENAGERIE_ROOT", Path(__file__).parents[3] / "shared" / "menagerie"))
WAVING = """
<mujoco><worldbody><body name="post"><geom type="capsule" fromto="0 0 0 0 0 .3" size=".02"/>
  <body name="flag" pos="0 0 .3"><joint name="wave" axis="0 1 0"/><geom type="box" size=".1 .01 .05"/></body>
</body></worldbody><keyframe><key name="up" qpos="1"/></keyframe></mujoco>
"""


def test_the_arm_has_the_joints_and_limits_of_its_config():
    model = compile_model("arm", "table")
    for joint in ARM.joints:
        assert tuple(model.joint(joint.name).range) == pytest.approx(joint.range_rad)
        assert model.actuator(joint.name).forcerange[1] == joint.torque_limit


def test_a_flexed_forearm_is_one_passive_joint_more():
    stiff, soft = compose(arm(), "table").model, compose(arm(flex=Flex(stiffness=200, damping=1)), "table").model
    assert (soft.nv, soft.nu) == (stiff.nv + 1, stiff.nu)
    assert soft.joint("flex").stiffness[0] == 200


def test_a_robot_given_as_mjcf_stands_in_the_scene(tmp_path):
    path = tmp_path / "waving.xml"
    path.write_text(WAVING)
    body = load_body(str(path))
    model = compose(body, "table").model
    assert (body.root, body.joints) == ("post", ("wave",))
    assert {"post", "flag", "object", "target"} <= {model.body(i).name for i in range(model.nbody)}


def test_our_own_urdf_loads_back_and_stands_in_the_scene(tmp_path, setup):
    path = tmp_path / "arm.urdf"
    path.write_text(robot_urdf(setup.model, "base_link", "arm"))
    body = from_file(path)
    assert body.joints == (*setup.body.joints, "left_slide", "right_slide")
    again, data = compose(body, "table").model, mujoco.MjData(setup.model)
    data_again = mujoco.MjData(again)
    for k, name in enumerate(setup.body.joints):
        data.joint(name).qpos[0] = data_again.joint(name).qpos[0] = 0.1 * k - 0.2
    mujoco.mj_forward(setup.model, data)
    mujoco.mj_forward(again, data_again)
    assert np.allclose(data.body("left_finger").xpos, data_again.body("left_finger").xpos, atol=1e-8)


@pytest.mark.skipif(not (MENAGERIE / "unitree_h1" / "h1.xml").exists(),
                    reason="MENAGERIE_ROOT names no folder of MuJoCo Menagerie's models")
def test_a_humanoid_of_the_menagerie_stands_in_the_scene():
    body = from_file(MENAGERIE / "unitree_h1" / "h1.xml")
    model = compose(body, "table").model
    assert len(body.joints) == 19
    assert model.body("object").id > model.body(body.root).id


@pytest.mark.parametrize("text", [None, "", "not xml", "<mujoco/>", '<mujoco><worldbody><body name="b"><geom mesh="x" '
                                  'type="mesh"/></body></worldbody></mujoco>'],
                         ids=["missing", "empty", "garbage", "no body", "lost mesh"])
def test_a_file_that_is_no_robot_says_where_and_what_to_give(tmp_path, text):
    path = tmp_path / "robot.xml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(SimulationError, match=r"robot\.xml\n  mend: give (an MJCF or URDF file|a file with)"):
        load_body(str(path))


@pytest.mark.parametrize(("ask", "names"), [
    (lambda: load_body("crane"), "PATH.urdf, PATH.xml, arm"), (lambda: compile_model("arm", "floor"), "ground, table"),
    (lambda: load_task("stack"), "pick-place"),
], ids=["robot", "scene", "task"])
def test_an_unknown_name_lists_every_valid_one(ask, names):
    with pytest.raises(ConfigError, match=f"mend: use one of: {names}"):
        ask()


def test_a_body_without_a_tool_is_not_driven(tmp_path, starts):
    path = tmp_path / "waving.xml"
    path.write_text(WAVING)
    with pytest.raises(SimulationError, match=r"robot has no tool(.|\n)*mend: .* use robot arm"):
        World(compose(load_body(str(path)), "table"), starts(1), from_draws([()]))
