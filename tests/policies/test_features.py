import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from pipeline.frames import ENVIRONMENT, STATE
from pipeline.policies.features import FEATURES, INPUTS
from pipeline.policies.network import ChunkedNet, Shape, array, tensor

NAMES = [f"{f.shape} {f.plus}-{f.minus}" for features in FEATURES.values() for f in features]


def features(values: dict[str, float]) -> dict[str, float]:
    row = np.array([[values.get(name, 0.0) for name in INPUTS]], np.float32)
    with torch.no_grad():
        out = ChunkedNet(Shape(1, 8, 1)).features(tensor(row[:, :len(STATE)]), tensor(row[:, len(STATE):]))
    return dict(zip(NAMES, array(out)[0].tolist(), strict=True))


places = st.floats(-0.5, 0.5, width=32)


@given(shift=places, hand=places, cube=places)
def test_a_scene_moved_sideways_differs_only_in_where_the_hand_is(shift: float, hand: float, cube: float):
    here = features({"ee_y": hand, "cmd_y": hand, "object_y": cube, "target_y": 0.1})
    there = features({"ee_y": hand + shift, "cmd_y": hand + shift, "object_y": cube + shift, "target_y": 0.1 + shift})
    moved = {name for name in NAMES if abs(here[name] - there[name]) > 1e-4}
    assert moved <= {"linear ee_y-None"}


@given(yaw=st.floats(-3, 3), turns=st.integers(-2, 2))
def test_a_cube_turned_by_quarters_looks_the_same(yaw: float, turns: int):
    assert np.allclose(list(features({"object_yaw": yaw}).values()),
                       list(features({"object_yaw": yaw + turns * np.pi / 2}).values()), atol=1e-4)


def test_features_say_what_their_names_say():
    got = features({"gripper": 0.03, "ee_x": 0.3, "ee_yaw": 0.1, "object_x": 0.31, "object_yaw": 0.2, "cmd_x": 0.28,
                    "cmd_gripper": 0.01, "target_z": 0.02})
    want = {"linear gripper-None": 0.03, "linear object_x-ee_x": 0.01, "linear cmd_x-ee_x": -0.02,
            "linear target_z-object_z": 0.02, "tanh object_x-ee_x": np.tanh(0.4),
            "tanh gripper-cmd_gripper": np.tanh(0.8),
            "sin object_yaw-ee_yaw": np.sin(0.4), "cos object_yaw-ee_yaw": np.cos(0.4)}
    assert np.allclose([got[name] for name in want], list(want.values()), atol=1e-5)


def test_joints_do_not_reach_the_network():
    assert not {f.plus for features in FEATURES.values() for f in features} & {f"joint{i}" for i in range(1, 7)}
    assert set(INPUTS) == {*STATE, *ENVIRONMENT}
