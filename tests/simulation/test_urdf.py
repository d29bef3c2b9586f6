"""URDF from a compiled model: loaded again by MuJoCo, every body and axis stands where it stood."""

from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import ConfigError, SimulationError
from pipeline.simulation.urdf import robot_urdf

MJCF = """
<mujoco>
  <compiler angle="radian"/>
  <asset><material name="red" rgba="1 0 0 1"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="base" pos=".1 .2 .3" euler="0 0 .4">
      <geom type="cylinder" size=".05 .04" material="red"/>
      <body name="upper" pos="0 0 .1" euler=".3 -.2 .1">
        <joint name="shoulder" axis="0 0 1" range="-2 2" actuatorfrcrange="-30 30"/>
        <geom type="capsule" fromto="0 0 0 0 .1 .2" size=".02"/>
        <body name="elbow" pos="0 .05 .2" euler="0 1.5707963267948966 0">
          <joint name="bend" axis="0 1 1" pos=".01 .02 -.03" ref=".3"/>
          <joint name="twist" axis="1 0 0" pos="0 0 .02"/>
          <geom type="box" size=".02 .03 .04" pos=".01 0 0" euler=".5 0 0"/>
          <geom name="hull" type="box" size=".03 .03 .05" group="3"/>
          <body name="finger" pos=".03 0 0"><joint name="slide" type="slide" axis="0 1 0" range="0 .04" ref=".01"/>
            <geom type="sphere" size=".01"/></body>
          <body name="camera" pos="0 0 .05" euler="0 0 1"><geom type="box" size=".01 .01 .01" mass=".1"/></body>
        </body>
      </body>
    </body>
    <body name="cube" pos="1 0 0"><freejoint/><geom type="box" size=".02 .02 .02"/></body>
  </worldbody>
  <actuator><position joint="slide" kp="100" forcerange="-5 5" gear="2"/></actuator>
</mujoco>
"""
AS_IT_IS = '<mujoco><compiler fusestatic="false" discardvisual="false" balanceinertia="false"/></mujoco>'
MODEL = mujoco.MjModel.from_xml_string(MJCF)


def again(text: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(text.replace("</robot>", AS_IT_IS + "</robot>"))


@settings(max_examples=50, deadline=None)
@given(st.tuples(st.floats(-2, 2), st.floats(-3, 3), st.floats(-3, 3), st.floats(0, 0.04)))
def test_every_body_and_axis_stands_where_it_stood(values):
    back = again(robot_urdf(MODEL, "base", "arm"))
    old, new = mujoco.MjData(MODEL), mujoco.MjData(back)
    for name, value in zip(("shoulder", "bend", "twist", "slide"), values, strict=True):
        old.joint(name).qpos[0] = new.joint(name).qpos[0] = value
    mujoco.mj_forward(MODEL, old)
    mujoco.mj_forward(back, new)
    base = old.body("base")
    turn = base.xmat.reshape(3, 3)
    for name in ("upper", "elbow", "finger", "camera"):
        np.testing.assert_allclose(turn.T @ (old.body(name).xpos - base.xpos), new.body(name).xpos, atol=1e-8)
        np.testing.assert_allclose(turn.T @ old.body(name).xmat.reshape(3, 3), new.body(name).xmat.reshape(3, 3),
                                   atol=1e-8)
        np.testing.assert_allclose(turn.T @ (old.body(name).xipos - base.xpos), new.body(name).xipos, atol=1e-8)
    for name in ("shoulder", "bend", "twist", "slide"):
        np.testing.assert_allclose(turn.T @ old.joint(name).xaxis, new.joint(name).xaxis, atol=1e-8)


def test_limits_masses_and_shapes_survive():
    text = robot_urdf(MODEL, "base", "arm")
    back, robot = again(text), ET.fromstring(text)
    kinds = {j.get("name"): j.get("type") for j in robot.iter("joint")}
    assert kinds == {"shoulder": "revolute", "bend": "continuous", "twist": "continuous", "elbow_fixed": "fixed",
                     "slide": "prismatic", "camera_fixed": "fixed"}
    np.testing.assert_allclose(back.joint("shoulder").range, [-2, 2])
    np.testing.assert_allclose(back.joint("slide").range, [0, 0.04])
    assert robot.find("joint[@name='shoulder']/limit").get("effort") == "30"
    assert robot.find("joint[@name='slide']/limit").get("effort") == "10", "the actuator's limit times its gear"
    for name in ("upper", "elbow", "finger", "camera"):
        np.testing.assert_allclose(back.body(name).mass, MODEL.body(name).mass, rtol=1e-8)
        np.testing.assert_allclose(back.body(name).inertia, MODEL.body(name).inertia, rtol=1e-6)
    shapes = {link.get("name"): [g[0].tag for g in link.iter("geometry")] for link in robot.iter("link")}
    assert shapes["base"] == ["cylinder"]
    assert shapes["upper"] == ["cylinder", "sphere", "sphere"]
    assert shapes["elbow"] == ["box"], "the collision hull of group 3 is not drawn"
    assert robot.find("link[@name='base']/visual/material/color").get("rgba") == "1 0 0 1"
    assert "cube" not in shapes, "only the tree below the root is the robot"


def test_the_links_are_the_bodies_so_that_tf_moves_them():
    links = {link.get("name") for link in ET.fromstring(robot_urdf(MODEL, "base", "arm")).iter("link")}
    assert {"base", "upper", "elbow", "finger", "camera"} <= links


def test_an_unknown_root_lists_the_bodies():
    with pytest.raises(ConfigError, match="use one of: base, camera, cube"):
        robot_urdf(MODEL, "bas", "arm")


def test_a_ball_joint_is_refused_with_the_mend():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="a"><geom size=".1"/><body name="b"><joint name="hip" type="ball"/>'
        '<geom size=".1"/></body></body></worldbody></mujoco>')
    with pytest.raises(SimulationError, match=r"no ball or free joints\n.*joint hip\n.*hinges and slides"):
        robot_urdf(model, "a", "x")
