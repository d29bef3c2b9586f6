"""What a signal had said of an attempt by a certain tick, and when a rule on it would have spoken."""

import numpy as np

from pipeline.trace import Rows


def mean_until(values: Rows, stop: int) -> float:
    """Mean over the first `stop` ticks, or as many as there are, of what is known; NaN where nothing is."""
    known = values[:stop][np.isfinite(values[:stop])]
    return float(known.mean()) if len(known) else np.nan


def last_until(values: Rows, stop: int) -> float:
    """The newest known value of the first `stop` ticks; NaN where there is none."""
    known = values[:stop][np.isfinite(values[:stop])]
    return float(known[-1]) if len(known) else np.nan


def first_lasting(values: Rows, above: float, ticks: int = 1) -> int | None:
    """Tick at which a signal has been above a value for so many ticks in a row, unknown ones left out of the count."""
    run = 0
    for tick, value in enumerate(values):
        if np.isnan(value):
            continue
        run = run + 1 if value > above else 0
        if run >= ticks:
            return tick
    return None
