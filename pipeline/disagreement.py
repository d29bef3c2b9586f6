"""Disagreement: how far two policies are apart in what they would do now."""

import numpy as np

from pipeline.protocols import Array
from pipeline.simulation.world import LIMITS, OPEN_M

ACTION_SCALE = np.array([*LIMITS, OPEN_M])
"""Unit of each action value in the disagreement: the controller's limits and the full opening."""


def disagreement(one: Array, other: Array, scale: Array = ACTION_SCALE) -> Array:
    """Mean distance of actions (n, w) in units of `scale`, shape (n,)."""
    return (np.abs(one - other) / scale).mean(axis=1)
