"""BalanceController: a robot stands by ankles and hips, written by hand; an expert whose attempts can be cloned.

What it does is known as ankle and hip strategy (Horak, Nashner 1986, J. Neurophysiology 55:1369): lean and its rate
turn the joints that can act against it. It takes no step, so blows that call for one throw it over.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.world import TURN_SCALE
from pipeline.protocols import Array

type Gains = Mapping[str, tuple[float, float]]
"""Part of a joint's name -> how far it turns for a lean [rad/rad], and for the lean's rate [rad per rad/s]."""

FORWARD: Gains = MappingProxyType({"ankle_pitch": (0.365, 0.145), "hip_pitch": (-0.245, 0.03), "knee": (0.47, 0.015)})
"""Joints that act against a lean about the y axis."""
SIDEWAYS: Gains = MappingProxyType({"ankle_roll": (0.62, 0.09), "hip_roll": (0.32, 0.39)})
"""Joints that act against a lean about the x axis. Both: found for the biped by the cross-entropy method, ten rounds of
24 gains, each on 24 starts of 5 s (starts of tuning, none of any evaluation)."""


class BalanceController:
    """Maps what a robot senses to actions, shapes (n, w) -> (n, j); it remembers nothing.

    Args:
        body: a robot with position servos and joints of the names above.

    Raises:
        ConfigError: it has motors instead of servos, or none of those joints.
    """

    def __init__(self, body: LeggedBody) -> None:
        gains = [[_gain(joint, FORWARD), _gain(joint, SIDEWAYS)] for joint in body.joints]
        if body.control != "position" or not np.any(gains):
            raise ConfigError("the balance controller turns servos of hips, knees and ankles, this robot has none",
                              where=", ".join(body.joints[:4]),
                              mend="clone a policy of this robot: name the folder of its training")
        self._lean, self._rate = np.moveaxis(np.array(gains) / body.scale, 2, 0)
        """Shares for lean and rate, forward and sideways, shape (j, 2)."""

    def __call__(self, sensed: NDArray[np.float32]) -> Array:
        """Actions in [-1, 1]."""
        turning, up = sensed[:, :3].astype(np.float64) / TURN_SCALE, sensed[:, 3:6].astype(np.float64)
        lean = np.column_stack([-up[:, 0], up[:, 1]])
        return np.clip(lean @ self._lean.T + turning[:, [1, 0]] @ self._rate.T, -1.0, 1.0)


def _gain(joint: str, gains: Gains) -> tuple[float, float]:
    return next((values for part, values in gains.items() if part in joint), (0.0, 0.0))
