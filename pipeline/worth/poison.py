"""POISONS: known ways in which a batch of corrections can be wrong, to try the doors with.

Each makes of the frames of a good episode those of a bad one. What is recorded beside the action (joints, commanded
pose) stays as it was, as where a device is wired wrongly, a log is shifted, or a mark is confused with another.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from pipeline.frames import ACTION, ENVIRONMENT, Frames
from pipeline.simulation.tasks import PickPlace

SHIFT_TICKS = 4
"""At 20 Hz 0.2 s: about the delay of a camera that was not compensated for."""

type Poison = Callable[[Frames, PickPlace, np.random.Generator], Frames]

_TARGET = slice(ENVIRONMENT.index("target_x"), ENVIRONMENT.index("target_y") + 1)
_MOTION = slice(0, ACTION.index("gripper"))


def negated(frames: Frames, task: PickPlace, rng: np.random.Generator) -> Frames:
    """Every motion the other way round; the gripper as it was."""
    action = frames.action.copy()
    action[:, _MOTION] *= -1
    return replace(frames, action=action)


def permuted(frames: Frames, task: PickPlace, rng: np.random.Generator) -> Frames:
    """The actions of the episode in random order."""
    return replace(frames, action=frames.action[rng.permutation(len(frames))])


def shifted(frames: Frames, task: PickPlace, rng: np.random.Generator) -> Frames:
    """Every action SHIFT_TICKS later than it was sent."""
    return replace(frames, action=frames.action[np.maximum(np.arange(len(frames)) - SHIFT_TICKS, 0)])


def other_task(frames: Frames, task: PickPlace, rng: np.random.Generator) -> Frames:
    """What was seen names another mark than the one that the object is carried to."""
    seen = frames.environment.copy()
    seen[:, _TARGET] = task.sample_target(rng, *map(float, seen[-1, _TARGET]))
    return replace(frames, environment=seen)


POISONS: Mapping[str, Poison] = MappingProxyType({
    "negated": negated, "permuted": permuted, "shifted": shifted, "other-task": other_task,
})
"""Name -> what it does. Add one: a function and an entry here."""
