"""Sensed: what a legged robot measures, read out of its observations in units of its own."""

from dataclasses import dataclass

import numpy as np

from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.world import SPEED_SCALE, TURN_SCALE
from pipeline.protocols import Array


@dataclass(frozen=True, slots=True)
class Sensed:
    """What n robots measure at one tick, in units of its own."""

    turning: Array
    """Turning speed of the base about its own axes [rad/s], shape (n, 3): gyroscope."""
    up: Array
    """The world's up in the base's frame, shape (n, 3): the IMU's filter."""
    joints: Array
    """Angles of the joints [rad], shape (n, j): encoders."""
    rates: Array
    """Speeds of the joints [rad/s], shape (n, j): encoders."""
    command: Array
    """Speed asked for: forward, left [m/s], turning [rad/s]; shape (n, 3)."""

    @property
    def upright(self) -> Array:
        """Orientation w, x, y, z of the base without a heading, which no IMU has of itself; shape (n, 4)."""
        return tilt_of(self.up)


def sensed(state: Array, body: LeggedBody) -> Sensed:
    """What observations hold, shape (n, w); see LeggedWorld.observe."""
    j = len(body.joints)
    return Sensed(state[:, :3] / TURN_SCALE, state[:, 3:6], state[:, 6:6 + j] + np.array(body.home),
                  state[:, 6 + j:6 + 2 * j] / SPEED_SCALE, state[:, 6 + 3 * j:9 + 3 * j])


def tilt_of(up: Array) -> Array:
    """The shortest turn that brings the world's up to where it is in the base's frame, as quaternions, (n, 4)."""
    x, y, z = (up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)).T
    w = np.sqrt(np.maximum((1 + z) / 2, 1e-12))
    return np.stack([w, y / (2 * w), -x / (2 * w), np.zeros_like(w)], axis=1)
