"""REWARDS: what attempts of legged robots are worth at a tick; each term is a plain function of what happens."""

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array


@dataclass(frozen=True, slots=True)
class Motion:
    """What n robots do at one tick, true: rewards and judges see it, policies do not."""

    up: Array
    """The world's up in the base's frame, shape (n, 3)."""
    height: Array
    """Height of the base over that at home [1], shape (n,)."""
    velocity: Array
    """Speed of the base in its own heading: forward, left [m/s], turning [rad/s]; shape (n, 3)."""
    command: Array
    """What speed is asked for, as `velocity`."""
    joints: Array
    """Deviation of the joints from home [rad], shape (n, j)."""
    effort: Array
    """Actuator forces as shares of their limits [1], shape (n, j)."""
    action: Array
    """The action of this tick, shape (n, j)."""
    previous: Array
    """The action of the tick before, shape (n, j)."""
    contact: NDArray[np.bool_]
    """Which feet press on the ground, shape (n, feet)."""
    phase: Array
    """The gait's clock, in [0, 1), shape (n,)."""


LEAN, SINK, DRIFT_M_S, BEND_RAD, SLOW_M_S, TURN_RAD_S = 0.3, 0.1, 0.3, 0.5, 0.25, 0.5
"""Deviations at which the terms below have fallen to 1/e."""


def upright(now: Motion) -> Array:
    """exp(-(lean / 0.3)^2) with the lean as the sine of its angle: 1 for a base that stands upright."""
    return np.exp(-(now.up[:, 0] ** 2 + now.up[:, 1] ** 2) / LEAN**2)


def height(now: Motion) -> Array:
    """exp(-(missing height / 0.1)^2), as a share of the height at home."""
    return np.exp(-((now.height - 1) / SINK) ** 2)


def still(now: Motion) -> Array:
    """exp(-(speed over ground / 0.3 m/s)^2)."""
    return np.exp(-(now.velocity[:, 0] ** 2 + now.velocity[:, 1] ** 2) / DRIFT_M_S**2)


def posture(now: Motion) -> Array:
    """exp(-mean squared deviation of the joints from home / (0.5 rad)^2)."""
    return np.exp(-(now.joints**2).mean(axis=1) / BEND_RAD**2)


def effort(now: Motion) -> Array:
    """Mean squared share of the motors' limits that is used."""
    return (now.effort**2).mean(axis=1)


def velocity(now: Motion) -> Array:
    """exp(-(error of the speed over ground / 0.25 m/s)^2), forward and to the left.

    Source: Rudin et al. 2021, arXiv 2109.11978, whose term falls to 1/e at 0.5 m/s.
    """
    error = now.velocity[:, :2] - now.command[:, :2]
    return np.exp(-(error**2).sum(axis=1) / SLOW_M_S**2)


def heading(now: Motion) -> Array:
    """exp(-(error of the turning speed / 0.5 rad/s)^2). Source: as that of `velocity`."""
    return np.exp(-((now.velocity[:, 2] - now.command[:, 2]) / TURN_RAD_S) ** 2)


def gait(now: Motion) -> Array:
    """Share of the feet that do what the clock says: each in turn stands for half a period and swings for half.

    Source: Siekmann et al. 2021, arXiv 2011.01387, with whether a foot presses in place of forces and speeds of feet.
    """
    feet = now.contact.shape[1]
    stands = (now.phase[:, None] + np.arange(feet) / feet) % 1.0 < 0.5
    return (stands == now.contact).mean(axis=1)


def smooth(now: Motion) -> Array:
    """Mean squared change of the action from tick to tick."""
    return ((now.action - now.previous) ** 2).mean(axis=1)


type Term = Callable[[Motion], Array]

REWARDS: MappingProxyType[str, Term] = MappingProxyType({
    "upright": upright, "height": height, "still": still, "posture": posture, "effort": effort,
    "velocity": velocity, "heading": heading, "gait": gait, "smooth": smooth,
})
"""Term -> what it measures; a task names the terms that it weighs. Add one: a function, and an entry here."""
