"""Plans that break the simulation: MuJoCo begins anew where numbers are lost, which would look like a good plan."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

LOST = [int(w) for w in (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL,
                         mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_BADCTRL)]
"""Warnings after which a simulation is not what was asked for."""


def forget(batch: Batch) -> None:
    """Begin to count anew."""
    batch.warning[:] = 0


def broken(batch: Batch) -> NDArray[np.bool_]:
    """Which simulations have lost their numbers since then, shape (nsim,)."""
    lost: NDArray[np.bool_] = batch.warning[:, LOST, 1] > 0
    return np.any(lost, axis=1)
