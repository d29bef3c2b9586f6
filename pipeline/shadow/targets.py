"""What a candidate's answers would have sent to the joints."""

from collections.abc import Callable

import numpy as np

from pipeline.protocols import Array, Ids


def joint_targets(would_send: Callable[[Array, Ids], Array], action: Array, ids: Ids, width: int = 7) -> Array:
    """What actions would send to the joints, shape (len(ids), width); NaN for a silent candidate.

    Args:
        would_send: of the world or robot; asked only for actions that are finite.
        action: of a candidate, shape (len(ids), ...).
        ids: its attempts.
        width: joint targets [rad] and opening [m] of the reference arm, or the joints of another robot.
    """
    there = np.isfinite(action).all(axis=1)
    targets = np.full((len(ids), width), np.nan)
    if there.any():
        targets[there] = would_send(action[there], ids[there])
    return targets
