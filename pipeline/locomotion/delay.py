"""DelayLine: what was asked for and is still on its way, for motors that hear late."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array, Ids


class DelayLine:
    """Commands of n robots, each with a delay of its own.

    Args:
        delay: of each robot [steps of the engine], shape (n,).
        substeps: steps of the engine in a control period.
        joints: how many are commanded.
    """

    def __init__(self, delay: NDArray[np.int64], substeps: int, joints: int) -> None:
        self._late = _late(delay, substeps)
        self.asked = np.zeros((len(delay), 1 + max(int(late.max()) for late, _ in self._late), joints))
        """What was asked for at this tick and before, the newest first, shape (n, k, joints)."""

    def ask(self, action: Array, ids: Ids) -> None:
        """A new command for these robots, shape (len(ids), joints)."""
        self.asked[ids, 1:] = self.asked[ids, :-1]
        self.asked[ids, 0] = action

    def heard(self, ids: Ids) -> Iterator[tuple[Array, int]]:
        """What the motors hear within this tick, (len(ids), joints), and for how many steps; one after the other."""
        for late, steps in self._late:
            yield self.asked[ids, late[ids]], steps


def _late(delay: NDArray[np.int64], substeps: int) -> list[tuple[NDArray[np.int64], int]]:
    """How many commands ago the motors of each robot heard what they do, and for how many steps of the engine.

    Args:
        delay: of each robot [steps of the engine].
        substeps: of a control period; the parts of what is returned make one up.
    """
    parts: list[tuple[NDArray[np.int64], int]] = []
    for step in range(substeps):
        late = np.maximum(-((step - delay) // substeps), 0)
        if parts and np.array_equal(parts[-1][0], late):
            parts[-1] = (late, parts[-1][1] + 1)
        else:
            parts.append((late, 1))
    return parts
