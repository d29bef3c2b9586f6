"""Deployed: what came of a policy's work on a robot, whatever robot it is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array
from pipeline.signals.curves import Curves
from pipeline.simulation.recordings import Recorded
from pipeline.trace import Trace


@dataclass(frozen=True, slots=True)
class Deployed:
    """Recorded attempts; the truth is for the report alone."""

    recorded: tuple[Recorded, ...]
    truth: NDArray[np.bool_]
    """Whether each attempt really succeeded, shape (n,)."""
    robot_s: float
    """Robot time spent [s]."""
    disagreement: Array
    """Mean disagreement of the first rider with the champion in each attempt, NaN without an answer, shape (n,)."""
    shadows: Mapping[str, str]
    """Candidate that rode along -> what became of it, see pipeline.shadow.riders.Riders.states."""
    signals: Curves = field(default_factory=dict[str, Mapping[str, list[float | None]]])
    """Signals of risk by tick, of attempts that succeeded and that failed; empty where nobody watched."""


def apart(traces: Sequence[Trace]) -> Array:
    """Mean disagreement of the first rider in each attempt, over the ticks that it answered; NaN where none, (n,)."""
    return np.array([_mean(trace) for trace in traces])


def _mean(trace: Trace) -> float:
    for shadow in trace.shadows.values():
        known = shadow.disagreement[np.isfinite(shadow.disagreement)]
        return float(known.mean()) if len(known) else np.nan
    return np.nan
