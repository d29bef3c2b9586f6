"""Curves of signals over many attempts, for a report: those that failed beside those that succeeded."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.trace import Rows

FEWEST = 3
"""Attempts still running below which a mean says more of one of them than of its kind."""
KINDS = ("success", "failure")

type Curves = Mapping[str, Mapping[str, list[float | None]]]
"""Signal -> 'success' or 'failure' -> mean at each tick over the attempts that still run; None where unknown."""


def curves(signals: Sequence[Mapping[str, Rows]], failed: NDArray[np.bool_]) -> Curves:
    """Means by tick; a kind with fewer than three attempts has no curve.

    Args:
        signals: of each attempt.
        failed: by truth, shape (n,).
    """
    found: dict[str, dict[str, list[float | None]]] = {}
    for name in dict.fromkeys(name for each in signals for name in each):
        kinds = {kind: [s[name] for s, f in zip(signals, failed, strict=True) if f == (kind == "failure") and name in s]
                 for kind in KINDS}
        found[name] = {kind: _mean(rows) for kind, rows in kinds.items() if len(rows) >= FEWEST}
    return {name: kinds for name, kinds in found.items() if kinds}


def _mean(rows: Sequence[Rows]) -> list[float | None]:
    longest = sorted((len(r) for r in rows), reverse=True)[FEWEST - 1]
    means: list[float | None] = []
    for tick in range(longest):
        now = np.array([r[tick] for r in rows if len(r) > tick])
        known = now[np.isfinite(now)]
        means.append(round(float(known.mean()), 4) if len(known) else None)
    return means
