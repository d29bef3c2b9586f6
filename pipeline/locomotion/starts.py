"""Starts: how one attempt of a legged robot begins and what will push it, drawn from a seed alone."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pipeline.errors import unknown
from pipeline.protocols import Array
from schemas.legged import LeggedStart

if TYPE_CHECKING:
    from pipeline.locomotion.body import LeggedBody
    from pipeline.locomotion.tasks import LeggedTask

CROUCH = {"knee": 0.8, "hip_pitch": -0.4, "ankle": -0.4}
"""Joint name parts -> how far a full crouch bends them beyond home [rad]; the feet stay flat under the hips."""


@dataclass(frozen=True, slots=True)
class Start:
    """One attempt before anybody acts."""

    height_m: float
    """Of the base [m]."""
    quaternion: Array
    """Orientation of the base w, x, y, z."""
    velocity: Array
    """Of the base, over ground [m/s], then about its own axes [rad/s], shape (6,)."""
    bend: Array
    """Deviation of the joints from home [rad]."""
    command: Array
    """Speed asked for: forward, left [m/s], turning [rad/s]."""
    blows: Array
    """Tick, and change of speed over ground [m/s]; shape (k, 3)."""
    rates: Array | None = None
    """Speeds of the joints [rad/s]; all 0 where None."""


def as_data(start: Start) -> LeggedStart:
    """The same start as plain data; numbers stay what they are to the last bit."""
    return LeggedStart.model_validate({
        "height_m": start.height_m, "quaternion": start.quaternion.tolist(), "velocity": start.velocity.tolist(),
        "bend": start.bend.tolist(), "rates": [] if start.rates is None else start.rates.tolist(),
        "command": start.command.tolist(), "blows": start.blows.tolist()})


def from_data(data: LeggedStart) -> Start:
    """What `as_data` was given."""
    return Start(data.height_m, np.array(data.quaternion), np.array(data.velocity), np.array(data.bend),
                 np.array(data.command), np.array(data.blows).reshape(-1, 3),
                 np.array(data.rates) if data.rates else None)


def seed_of(*words: int) -> int:
    """A seed that follows from numbers and words alone; no two different rows of them share one, but by chance."""
    return int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0] >> 1)


def draw_start(task: "LeggedTask", body: "LeggedBody", stratum: str, seed: int) -> Start:
    """The start that this seed gives; ConfigError lists the kinds of start that there are."""
    if stratum not in task.starts:
        raise unknown("stratum", stratum, task.starts)
    kind, rng = task.starts[stratum], np.random.default_rng([seed, 61])
    lean, about = rng.uniform(0, kind.tilt_rad), rng.uniform(-np.pi, np.pi)
    quaternion = np.array([np.cos(lean / 2), np.sin(lean / 2) * np.cos(about), np.sin(lean / 2) * np.sin(about), 0.0])
    crouch = rng.uniform(*kind.crouch)
    bend = kind.joint_rad * rng.uniform(-1, 1, len(body.joints))
    bend += [crouch * next((v for part, v in CROUCH.items() if part in joint), 0.0) for joint in body.joints]
    speed, way = rng.uniform(0, kind.speed_m_s), rng.uniform(-np.pi, np.pi)
    velocity = np.array([speed * np.cos(way), speed * np.sin(way), 0.0, *kind.turn_rad_s * rng.uniform(-1, 1, 3)])
    command = np.array([rng.uniform(*limits) for limits in task.command])
    return Start(_height(body, bend), quaternion, velocity, bend, command, _blows(task, rng))


def pushed(start: Start, task: "LeggedTask", seed: int) -> Start:
    """The same beginning with other blows, those that this seed gives: nobody senses what blows will come."""
    return replace(start, blows=_blows(task, np.random.default_rng([seed, 62])))


def _height(body: "LeggedBody", bend: Array) -> float:
    """Height at which the feet meet the ground with bent knees, as far as two equal limbs tell it [m].

    Each limb is half of the leg. What is a little too high falls, what is a little too low is pushed out.
    """
    def stretched(angles: Array) -> float:
        hip = [a for j, a in zip(body.joints, angles, strict=True) if "hip_pitch" in j]
        knee = [a for j, a in zip(body.joints, angles, strict=True) if "knee" in j]
        if not hip or not knee:
            return 1.0
        return float(np.mean([(np.cos(h) + np.cos(h + k)) / 2 for h, k in zip(hip, knee, strict=True)]))

    home = np.array(body.home)
    return body.height_m * (0.06 + 0.94 * stretched(home + bend) / stretched(home)) + 0.01


def _blows(task: "LeggedTask", rng: np.random.Generator) -> Array:
    rows: list[tuple[float, float, float]] = []
    at = 0.0
    while task.pushes.speed_m_s and (at := at + rng.uniform(*task.pushes.every_s)) < task.seconds:
        speed, way = task.pushes.speed_m_s * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi)
        rows.append((round(at * task.control_hz), speed * np.cos(way), speed * np.sin(way)))
    return np.array(rows).reshape(-1, 3)
