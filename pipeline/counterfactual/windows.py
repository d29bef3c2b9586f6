"""Windows: where two policies are apart for a while."""

from dataclasses import dataclass

import numpy as np

from pipeline.protocols import Array
from schemas.counterfactual import JudgeConfig


@dataclass(frozen=True, slots=True)
class Window:
    """Ticks [start, stop) of a recording in which two policies are apart."""

    start: int
    stop: int
    disagreement: float
    """Mean over the window, in scales of the action."""


def first_window(apart: Array, config: JudgeConfig) -> Window | None:
    """The first stretch of at least `lasting` ticks in which the disagreement stays at or above the threshold.

    Only the first is judged: from there on the candidate would have been somewhere else, and what it thinks of the
    champion's later states says little about where it would have ended.

    Args:
        apart: disagreement at each tick, shape (m,).
        config: threshold and ticks.
    """
    over = np.concatenate([[False], apart >= config.threshold, [False]])
    edges = np.flatnonzero(over[1:] != over[:-1])
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if stop - start >= config.lasting:
            return Window(start, stop, float(apart[start:stop].mean()))
    return None
