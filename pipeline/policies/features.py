"""Relative features: what the network is told of an observation, as one matrix and three functions.

Positions are given relative to one another (cube to hand, target to cube), because a motion that works
here works as well 5 cm further on. Saturated copies magnify the last centimetres, where a grasp is
decided. The cube looks the same after a quarter turn, hence the sine and cosine of four times its yaw.

Every feature is f(gain * (plus - minus)) of two observed values, so that PyTorch, ONNX and a test
share the one matrix `MATRIX`.
"""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import ENVIRONMENT, STATE

type Shape = Literal["linear", "tanh", "sin", "cos"]

SATURATION_PER_M = 40.0
"""tanh(40 x) is linear within a centimetre and flat beyond five."""

SYMMETRY = 4.0
"""A square cube is the same after a turn of 2 pi / 4."""

INPUTS = (*STATE, *ENVIRONMENT)
"""Names of the 23 observed values, in the order the network takes them."""


@dataclass(frozen=True, slots=True)
class Feature:
    """One value the network sees: shape(gain * (plus - minus)), in metres or radians before the shape."""

    plus: str
    minus: str | None
    shape: Shape
    gain: float


def _pairs(shape: Shape, gain: float, *pairs: tuple[str, str | None]) -> tuple[Feature, ...]:
    return tuple(Feature(plus, minus, shape, gain) for plus, minus in pairs)


def _xyz(plus: str, minus: str) -> tuple[tuple[str, str | None], ...]:
    return tuple((f"{plus}_{axis}", f"{minus}_{axis}") for axis in "xyz")


_POSE: tuple[tuple[str, str | None], ...] = tuple((name, None) for name in ("ee_x", "ee_y", "ee_z", "ee_yaw"))
_NEAR = (*_xyz("object", "ee"), *_xyz("target", "object"), *_xyz("cmd", "ee"))
_GRIP: tuple[tuple[str, str | None], ...] = (("gripper", None), ("gripper", "cmd_gripper"))

FEATURES: MappingProxyType[Shape, tuple[Feature, ...]] = MappingProxyType({
    "linear": _pairs("linear", 1.0, ("gripper", None), *_POSE, *_xyz("object", "ee"), *_xyz("target", "object"),
                     *_xyz("target", "ee"), *_xyz("cmd", "ee"), ("cmd_yaw", "ee_yaw"), ("cmd_gripper", None)),
    "tanh": _pairs("tanh", SATURATION_PER_M, *_NEAR, *_GRIP),
    "sin": _pairs("sin", SYMMETRY, ("object_yaw", "ee_yaw")),
    "cos": _pairs("cos", SYMMETRY, ("object_yaw", "ee_yaw")),
})
"""Shape -> its features; the network sees them in this order."""

WIDTHS: tuple[int, ...] = tuple(len(features) for features in FEATURES.values())
"""Number of features of each shape."""


def matrix() -> NDArray[np.float32]:
    """The linear part of all features: raw (n, 23) @ matrix (23, sum(WIDTHS)), before the shapes."""
    flat = [feature for features in FEATURES.values() for feature in features]
    out = np.zeros((len(INPUTS), len(flat)), np.float32)
    for column, feature in enumerate(flat):
        out[INPUTS.index(feature.plus), column] += feature.gain
        if feature.minus is not None:
            out[INPUTS.index(feature.minus), column] -= feature.gain
    return out
