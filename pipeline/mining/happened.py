"""What happened in an attempt, in numbers that a robot senses, and the subtask in which it went wrong."""

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import STATE
from pipeline.protocols import Array
from pipeline.trace import Trace
from pipeline.triggers import FAR_M, GRIPPED_M, LOW_M, SETTLE_TICKS

_OPENING, _ASKED = STATE.index("gripper"), STATE.index("cmd_gripper")
_TOOL = slice(STATE.index("ee_x"), STATE.index("ee_z") + 1)
CLOSING_M, EMPTY_M = 0.04, 0.012
"""Opening asked for below which the gripper closes, and opening below which it holds nothing [m]."""
BETWEEN_M, STILL_M = 0.03, 0.001
"""Tool to object within which fingers can hold it, and motion of the fingers in a tick while they do [m]: fingers that
are still closing look like fingers around something, which is what triggers take them for (docs/mining.md)."""
NEAR_MARK_M = 0.05
"""Object to mark from which on it is being placed, twice what counts as success [m]."""
UNTOUCHED_TICKS = 5
"""The arm needs longer than that from its home to any object [ticks]."""

SUBTASKS = ("reach", "grasp", "lift", "carry", "place")
"""In the order in which they are done; an attempt fails in the first one that it does not finish."""

MARKED = ("carry", "place")
"""Those of them whose success is told by where the mark is."""

type Starts = Array
"""Perceived starts: x, y, z of the object at rest [m], shape (n, 3)."""


@dataclass(frozen=True, slots=True)
class Sensed:
    """One attempt as its robot perceived it; m ticks. Nothing in it is simulator truth."""

    start: Array
    """The object at rest: x, y, and its centre's height, which is half its size [m], shape (3,)."""
    unlike_m: float
    """Distance of the start to the nearest that was taught, horizontally [m]."""
    to_object: Array
    """Tool to object [m], shape (m,)."""
    opening: Array
    """Between the fingers [m], shape (m,)."""
    closing: NDArray[np.bool_]
    """Whether the gripper was asked to close, shape (m,)."""
    held: NDArray[np.bool_]
    """Whether the fingers have stood still around the object for some ticks, shape (m,)."""
    height: Array
    """Object above where it rested [m], shape (m,)."""
    moved: Array
    """Object from where it rested, horizontally [m], shape (m,)."""
    to_mark: Array
    """Object to mark, horizontally [m], shape (m,)."""


def start_of(environment: NDArray[np.floating]) -> Array:
    """x, y and height at rest of the object as perceived, its noise averaged out a little [m], shape (3,).

    Args:
        environment: see pipeline.frames.ENVIRONMENT, shape (m, 7); nothing has been touched in its first rows.
    """
    return environment[:UNTOUCHED_TICKS, :3].astype(np.float64).mean(axis=0)


def sensed(trace: Trace, taught: Starts) -> Sensed:
    """The courses of an attempt that everything here is told from.

    Args:
        trace: of the attempt.
        taught: starts that its policy learnt from; their heights are not read.
    """
    state, seen = trace.state, trace.environment
    to_object, opening = np.linalg.norm(state[:, _TOOL] - seen[:, :3], axis=1), state[:, _OPENING]
    closing = state[:, _ASKED] < CLOSING_M
    still = np.abs(np.diff(opening, prepend=np.inf)) < STILL_M
    between = closing & still & (to_object < BETWEEN_M) & (opening > GRIPPED_M)
    ended = np.maximum.accumulate(np.where(between, -1, np.arange(len(between))))
    start = start_of(seen)
    unlike = float(np.hypot(*(taught[:, :2] - start[:2]).T).min()) if len(taught) else 0.0
    return Sensed(start, unlike, to_object, opening, closing,
                  np.arange(len(between)) - ended >= SETTLE_TICKS, seen[:, 2] - start[2],
                  np.hypot(*(seen[:, :2] - start[:2]).T), np.hypot(*(seen[:, :2] - seen[:, 4:6]).T))


def subtask(s: Sensed) -> tuple[str, int]:
    """The first subtask that was not finished, and the tick at which it began.

    It may lie before the one in which the failure was noticed: what slips out "while it is carried" without ever
    having left the table was not lifted.
    """
    name, begins = SUBTASKS[0], 0
    for following, done in zip(SUBTASKS[1:], (s.to_object < FAR_M, s.held, s.held & (s.height > LOW_M),
                                              s.held & (s.to_mark < NEAR_MARK_M)), strict=True):
        reached = np.flatnonzero(done[begins:])
        if not len(reached):
            break
        name, begins = following, begins + int(reached[0])
    return name, begins


def _reached(s: Sensed) -> float:
    return float(SUBTASKS.index(subtask(s)[0]))


def _nearest(s: Sensed) -> float:
    return float(s.to_object.min())


def empty(s: Sensed) -> float:
    """For how long the fingers closed on nothing [ticks]."""
    return float((s.closing & (s.opening < EMPTY_M)).sum())


def _grip(s: Sensed) -> float:
    return float(np.median(s.opening[s.held])) if s.held.any() else 0.0


def _lifted(s: Sensed) -> float:
    return float(np.clip(s.height.max(), 0, 0.1))


def fell(s: Sensed) -> float:
    """How far the object came down again [m]."""
    return float(np.clip(s.height.max() - s.height[-1], 0, 0.1))


def pushed(s: Sensed) -> float:
    """How far the object moved before it was held [m]."""
    first = int(s.held.argmax()) if s.held.any() else len(s.held)
    return float(s.moved[:first].max(initial=0.0))


def _size(s: Sensed) -> float:
    return float(s.start[2])


def _unlike(s: Sensed) -> float:
    return s.unlike_m


class Feature(NamedTuple):
    """One number of an attempt."""

    unit: str
    scale: float
    """A difference that tells two ways of failing apart: one unit of distance."""
    of: Callable[[Sensed], float]


FEATURES: MappingProxyType[str, Feature] = MappingProxyType({
    "reached": Feature("subtasks", 1.0, _reached),
    "nearest": Feature("m", 0.03, _nearest),
    "empty": Feature("ticks", 10.0, empty),
    "grip": Feature("m", 0.01, _grip),
    "lifted": Feature("m", 0.05, _lifted),
    "fell": Feature("m", 0.05, fell),
    "pushed": Feature("m", 0.05, pushed),
    "size": Feature("m", 0.006, _size),
    "unlike": Feature("m", 0.05, _unlike),
})
"""Name -> how it is told: how far the attempt came, how near the tool came to the object, for how long the fingers
closed on nothing, how wide they stood around what they held, how high it was lifted, how far it fell, how far it was
pushed before it was held, its size, and how unlike the start was to all that was taught.

Add one: a function of what was sensed and an entry here."""


def described(s: Sensed) -> Array:
    """The features of an attempt, each over its scale, shape (len(FEATURES),)."""
    return np.array([feature.of(s) / feature.scale for feature in FEATURES.values()])
