"""What a candidate's answers would have sent to the joints."""

from collections.abc import Callable

import numpy as np

from pipeline.protocols import Array, Ids


def joint_targets(would_send: Callable[[Array, Ids], Array], action: Array, ids: Ids) -> Array:
    """Joint targets [rad] and opening [m] that actions would send, shape (len(ids), 7); NaN for a silent candidate.

    Args:
        would_send: of the world or robot; asked only for actions that are finite.
        action: of a candidate, shape (len(ids), 5).
        ids: its attempts.
    """
    there = np.isfinite(action).all(axis=1)
    targets = np.full((len(ids), 7), np.nan)
    if there.any():
        targets[there] = would_send(action[there], ids[there])
    return targets
