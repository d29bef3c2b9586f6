"""Inverse kinematics: poses of the workspace are reached, and what is out of reach does no harm."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.simulation.bodies import arm
from pipeline.simulation.kinematics import Kinematics
from pipeline.simulation.model import compose
from pipeline.simulation.world import HOME

SETUP = compose(arm(), "table")
KINEMATICS = Kinematics(SETUP, 1, 1)
START = np.array([SETUP.body.home])
poses = st.tuples(st.floats(0.2, 0.4), st.floats(-0.25, 0.25), st.floats(0.01, 0.25), st.floats(-0.7, 0.7))


@settings(max_examples=40, deadline=None)
@given(poses)
def test_a_pose_in_the_workspace_is_reached_within_a_millimetre(pose):
    target, q = np.array([pose]), START
    for _ in range(25):
        q = KINEMATICS.towards(q, target)
    position, rotation = KINEMATICS.pose(q)
    assert np.linalg.norm(position - target[:, :3]) < 1e-3
    assert abs(KINEMATICS.xyz_yaw(q)[0, 3] - pose[3]) < 5e-3
    assert rotation[0, 2, 2] < -0.9999  # the tool points down


def test_steps_of_one_tick_are_followed_within_a_millimetre():
    q, target = START, HOME.copy()
    for _ in range(40):
        q = KINEMATICS.towards(q, target[None])
    for _ in range(10):
        target += [0.004, 0.01, -0.012, 0.05]
        q = KINEMATICS.towards(q, target[None])
    assert np.linalg.norm(KINEMATICS.pose(q)[0][0] - target[:3]) < 1e-3


def test_a_pose_out_of_reach_leaves_the_joints_within_their_limits():
    q = START
    for _ in range(60):
        q = KINEMATICS.towards(q, np.array([[2.0, 2.0, -1.0, 3.0]]))
    limits = np.array([SETUP.model.joint(name).range for name in SETUP.body.joints])
    assert ((q[0] >= limits[:, 0]) & (q[0] <= limits[:, 1])).all()


def test_many_robots_are_solved_as_one_is():
    rng = np.random.default_rng(0)
    q = START + rng.normal(0, 0.1, (16, 6))
    target = HOME + rng.normal(0, 0.03, (16, 4))
    together = Kinematics(SETUP, 16, 2).towards(q, target)
    alone = np.concatenate([KINEMATICS.towards(q[i:i + 1], target[i:i + 1]) for i in range(16)])
    assert (together == alone).all()
