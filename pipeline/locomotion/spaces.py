"""What a legged robot's environment takes and gives, as Gymnasium's spaces."""

from typing import TYPE_CHECKING

import gymnasium as gym
import numpy as np

if TYPE_CHECKING:
    from pipeline.locomotion.world import LeggedWorld

SENSED_MOST = 100.0
"""What no value of an observation exceeds; further out it is cut off."""


def observation_space(world: "LeggedWorld") -> gym.spaces.Box:
    """What one robot senses; see LeggedWorld.observe."""
    return gym.spaces.Box(-SENSED_MOST, SENSED_MOST, (world.width,), np.float32)


def action_space(world: "LeggedWorld") -> gym.spaces.Box:
    """One share for each joint; see LeggedBody.scale."""
    return gym.spaces.Box(-1.0, 1.0, (world.action_size,), np.float32)
