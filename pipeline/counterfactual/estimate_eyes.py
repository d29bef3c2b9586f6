"""Eyes: how far the perceived object is off, told from the moments at which the fingers held it.

Between closed fingers the object's centre lies midway, so along the direction in which they close the perceived
position minus the tool's is the error of perception. Across that direction nothing is known of one grasp; grasps of
many yaws give both directions. Where nothing was held, training's own range is all there is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.counterfactual.estimate_log import ASKED, CLOSING_M, OPENING, TOOL, TOOL_YAW, SensedLog
from pipeline.counterfactual.moment import Lab
from pipeline.protocols import Array
from pipeline.simulation.expert import Expert
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.triggers import FAR_M
from schemas.scene import SceneSpec

PRIOR_SD_M = 0.008
"""Of each component of the bias before anything was held [m]: wider than training's, a real robot may lie outside."""
HELD_SD_M = 0.0007
"""How well an object is centred between the fingers, and the tool where its encoders say [m]."""
STEADY_M = 0.0008
"""The fingers have come to rest on something if they move by less than this a tick [m]."""
GRASPS, GRASP_TICKS = 6, 45
"""Attempts of the demonstrator, and how long each goes on."""
FITS_M = 0.004
"""... and on the object if they are as far apart as it is wide, give or take this [m]."""


@dataclass(frozen=True, slots=True)
class Eyes:
    """The error of the perceived position."""

    bias: Array
    """x, y [m]."""
    cov: Array
    """Of the bias, shape (2, 2)."""
    noise: float
    """Standard deviation of each perceived coordinate at each tick [m]."""
    holds: int
    """Grasps that it was told from."""

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Biases that may be true, shape (n, 2)."""
        return rng.multivariate_normal(self.bias, self.cov, n)


def holding(log: SensedLog, half_m: float) -> NDArray[np.bool_]:
    """At which ticks the fingers hold the object, by what the robot senses, shape (m,).

    Args:
        log: of the attempt.
        half_m: half edge of the object [m].
    """
    opening = log.state[:, OPENING]
    near = np.linalg.norm(log.state[:, TOOL] - log.environment[:, :3], axis=1) < FAR_M
    rest = np.abs(np.diff(opening, prepend=np.inf)) < STEADY_M
    return near & rest & (log.state[:, ASKED] < CLOSING_M) & (np.abs(opening - 2 * half_m) < FITS_M)


def across(yaw: Array) -> Array:
    """Direction in which the fingers close at a yaw of the tool, shape (..., 2)."""
    return np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)


def identify_eyes(logs: Sequence[SensedLog], halves: Sequence[float], middle_m: float) -> Eyes:
    """Bias and noise of one robot's eyes: one weighted equation a grasp, and a prior; outliers weigh less.

    Args:
        logs: attempts of one robot.
        halves: half edge of each one's object [m].
        middle_m: where between the fingers an object is held, see `middle`.
    """
    noise = _noise(logs)
    normals, gaps, errors = list[Array](), list[float](), list[float]()
    for log, half in zip(logs, halves, strict=True):
        held = np.flatnonzero(holding(log, half))
        if held.size >= 3:
            normal = across(log.state[held, TOOL_YAW])
            gap = log.environment[held, :2] - log.state[held, TOOL][:, :2]
            normals.append(normal.mean(axis=0))
            gaps.append(float((normal * gap).sum(axis=1).mean()) - middle_m)
            errors.append(HELD_SD_M ** 2 + noise ** 2 / held.size)
    if not gaps:
        return Eyes(np.zeros(2), PRIOR_SD_M ** 2 * np.eye(2), noise, 0)
    rows, gap, weight = np.stack(normals), np.array(gaps), 1 / np.array(errors)
    bias, cov = np.zeros(2), PRIOR_SD_M ** 2 * np.eye(2)
    trust = np.ones(len(gap))
    for _ in range(10):
        precision = (rows * (weight * trust)[:, None]).T @ rows + np.eye(2) / PRIOR_SD_M ** 2
        cov: Array = np.linalg.inv(precision).astype(np.float64)
        bias = cov @ (rows * (weight * trust)[:, None]).T @ gap
        trust = 1 / (1 + (gap - rows @ bias) ** 2 * weight / 4)
    return Eyes(bias, cov, noise, len(gap))


def middle(scene: SceneSpec, lab: Lab) -> float:
    """Where between the fingers of the simulated robot an object is held: one finger drives, the other follows.

    The demonstrator picks it up with perfect eyes, and what is off along the closing direction is no error of eyes.

    Args:
        scene: gives robot and task.
        lab: the simulation that stands in for the robot.

    Returns:
        Centre of the object beyond the tool along `across` [m].
    """
    scenes = [sample_scene(scene.task, "study", scene_seed("study", 61, i), next(iter(load_task(scene.task).common)))
              for i in range(GRASPS)]
    world, expert = lab.world(scenes, [()] * GRASPS), Expert()
    tracer = Tracer(world)
    expert.reset(GRASPS)
    rollout(world, expert, tracer=tracer, horizon=GRASP_TICKS)
    found = list[float]()
    for start, trace in zip(scenes, tracer.traces(), strict=True):
        log = SensedLog.of(trace, "the demonstrator")
        held = holding(log, start.object_half_m)
        gap = log.environment[held, :2] - log.state[held][:, TOOL][:, :2]
        found += (across(log.state[held, TOOL_YAW]) * gap).sum(axis=1).tolist()
    return float(np.median(found)) if found else 0.0


def _noise(logs: Sequence[SensedLog]) -> float:
    """From the ticks before the fingers first close: what does not move seems to."""
    steps = [np.diff(log.environment[:_first_closing(log), :2], axis=0).ravel() for log in logs]
    every = np.concatenate(steps) if steps else np.zeros(0)
    return float(1.4826 * np.median(np.abs(every)) / np.sqrt(2)) if every.size else 0.0


def _first_closing(log: SensedLog) -> int:
    closing = np.flatnonzero(log.state[:, ASKED] < CLOSING_M)
    return int(closing[0]) if closing.size else len(log)
