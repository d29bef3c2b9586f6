"""Perceived: the start of an attempt as its robot saw it, for a simulation that may not know more than that."""

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.tasks import load_task
from pipeline.triggers import stratum_of
from schemas.scene import SceneSpec


def as_perceived(scene: SceneSpec, seen: NDArray[np.floating]) -> SceneSpec:
    """A start with object, size and mark as perceived: the truth of a deployed attempt is not ours to know.

    Args:
        scene: of the attempt; what no robot senses of it, hidden physics above all, is left out or overwritten.
        seen: see pipeline.frames.ENVIRONMENT, at rest, shape (7,).
    """
    x, y, z, yaw, *target = (float(v) for v in seen)
    return scene.model_copy(update={
        "object_xy_m": (x, y), "object_yaw_rad": yaw, "target_xy_m": (target[0], target[1]), "twin": None,
        "object_half_m": load_task(scene.task).nearest_half(z), "stratum": stratum_of(np.asarray(seen, np.float64))})
