"""Robot: the physics of one robot's arm, identified from what it sensed in all its attempts.

Joints and their speeds are measured at every tick, so every tick is an experiment of its own: put the simulated arm
where the real one was, send what was sent, and compare where both are a tick later. Hypotheses are drawn from the
training ranges; from the best one on, the misses of a small ensemble are fitted by a plane and its zero is gone to
(Gauss-Newton without derivatives). Whether a command came a tick late is not known: both are played.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.counterfactual.estimate_log import ASKED, CLOSING_M, SensedLog
from pipeline.counterfactual.estimate_memory import memory, played
from pipeline.counterfactual.moment import Lab
from pipeline.protocols import Array
from pipeline.simulation.physics import MAX_DELAY, RANDOMIZATIONS, Physics, from_draws
from pipeline.simulation.world import World
from schemas.scene import SceneSpec

ARM = ("kp", "damping", "frictionloss", "backlash", "stiction")
"""What is identified by misses. Training draws no stiction and no jitter; real robots have both."""
LOWEST = np.array([0.1, 0.1, 0.0, 0.0, 0.0])
SPREAD = np.array([0.15, 0.2, 0.4, 0.002, 0.3])
"""Standard deviations of the first ensemble around the best of the first hypotheses."""
STICTION = 1.5
"""Largest stiction of the first hypotheses [1]."""
WIDEN = 1.5
"""Factor on training's ranges: a real robot may lie outside."""
LATE = 0.2
"""Share of late commands that is assumed until it is known."""
PLACES, TICKS, FIRST, NEXT, ROUNDS = 1024, 96, 120, 30, 6
"""Arms at once; ticks of the log that are played; first hypotheses; members of an ensemble; ensembles."""
SPEED_SCALE_S = 0.03
"""A speed that misses by v counts as much as a joint that misses by v times this."""


@dataclass(frozen=True, slots=True)
class ArmBelief:
    """What is believed of one robot's arm."""

    delay: float
    """[ticks]"""
    jitter: float
    """Share of commands that come a tick later still [1]."""
    values: Array
    """Best values of ARM."""
    sd: Array
    """Their standard errors."""
    miss_rad: float
    """How far a joint is missed a tick ahead, median over ticks of the RMS over joints [rad]."""


@dataclass(frozen=True, slots=True)
class _Tick:
    """One experiment."""

    log: SensedLog
    tick: int


def identify_arm(logs: Sequence[SensedLog], scene: SceneSpec, lab: Lab, seed: int) -> ArmBelief:
    """The physics of an arm, from all that its joints did.

    Args:
        logs: attempts of one robot.
        scene: any start of its task; its cube is put out of the way.
        lab: the simulation that stands in for the robot.
        seed: of all draws.

    Source: Gauss-Newton with the Jacobian of a fitted plane: Iglesias, Law and Stuart 2013, Inverse Problems 29:045001
    (ensembles in place of derivatives).
    """
    rng = np.random.default_rng([seed, 29])
    world = lab.world([scene.model_copy(update={"object_xy_m": AWAY[:2]})] * PLACES, [()] * PLACES)
    ticks = _ticks(logs, rng)
    tried, delays = _first(rng)
    misses = _misses(ticks, _physics(tried, delays), world)
    best = int(_likelihood(misses).argmax())
    delay, centre, spread = float(delays[best]), tried[best], SPREAD
    late, rest, sd = np.zeros(len(ticks), bool), misses[:, best, 0], SPREAD
    for _ in range(ROUNDS):
        members = np.maximum(centre + spread * rng.standard_normal((NEXT, len(ARM))), LOWEST)
        misses = _misses(ticks, _physics(members, np.full(NEXT, delay)), world)
        squares = np.median((misses ** 2).sum(axis=3), axis=1)
        late = squares[:, 1] < squares[:, 0]
        step, error, rest = _plane((members - centre) / spread, misses[np.arange(len(ticks)), :, late.astype(int)])
        centre = np.maximum(centre + spread * np.clip(step, -3, 3), LOWEST)
        sd, spread = error * spread, spread / 2
        if late.mean() > 0.5 and delay < MAX_DELAY:
            delay, late = delay + 1, ~late  # what mostly comes late by one has a longer delay
    return ArmBelief(delay, float((late.sum() + 1) / (len(late) + 2)), centre, sd,
                     _typical(rest[:, :6]))


def _typical(misses: Array) -> float:
    """Median over rows of the RMS over columns."""
    return float(np.sort(np.sqrt((misses ** 2).mean(axis=1)))[len(misses) // 2])


def _plane(offsets: Array, misses: Array) -> tuple[Array, Array, Array]:
    """Fit misses (e, m, 12) by a plane over offsets (m, d) and go to where it is least, outliers weighing less.

    Returns:
        Step (d,) and its standard error (d,), in units of the offsets, and the misses that are left (e, 12).
    """
    m, d = offsets.shape
    design = np.column_stack([np.ones(m), offsets])
    fit = np.linalg.lstsq(design, misses.transpose(1, 0, 2).reshape(m, -1), rcond=None)[0]
    level, slope = np.asarray(fit[0], np.float64), np.asarray(fit[1:].T, np.float64)
    step, square, left = np.zeros(d), np.eye(d), level.reshape(-1, 12)
    size, weight = np.ones(len(misses)), np.ones(len(misses))
    for _ in range(5):
        w = np.repeat(weight, 12)[:, None]
        square = (slope * w).T @ slope
        flat = square + 1e-3 * float(np.trace(square)) / d * np.eye(d)
        step = np.asarray(np.linalg.solve(flat, -(slope * w).T @ level), np.float64)
        left = (level + slope @ step).reshape(-1, 12)
        size = (left ** 2).sum(axis=1)
        weight = 1 / (1 + size / (float(np.sort(size)[len(size) // 2]) + 1e-12))
    variance = float((weight * size).sum() / (12 * weight.sum()))
    return step, np.sqrt(np.diag(np.linalg.inv(square + 1e-12 * np.eye(d))) * variance), left


def _ticks(logs: Sequence[SensedLog], rng: np.random.Generator) -> list[_Tick]:
    """Ticks drawn at random from those with the fingers open, fast ones more often."""
    every = [_Tick(log, k) for log in logs for k in range(len(log) - 1) if log.state[k, ASKED] > CLOSING_M]
    speed = np.array([np.abs(t.log.joint_velocity[t.tick, :6]).max() for t in every]) + 0.05
    rows = rng.choice(len(every), min(TICKS, len(every)), replace=False, p=speed / speed.sum())
    return [every[k] for k in rows.tolist()]


def _first(rng: np.random.Generator) -> tuple[Array, Array]:
    """The first hypotheses: values of ARM, shape (FIRST, 5), and delays [ticks], every one as often."""
    drawn = [[RANDOMIZATIONS[name](rng, WIDEN) for name in ARM[:-1]] for _ in range(FIRST)]
    values: Array = np.column_stack([drawn, rng.uniform(0, STICTION, FIRST)])
    return values, (np.arange(FIRST) % MAX_DELAY).astype(np.float64)


def _physics(values: Array, delays: Array) -> Physics:
    physics = from_draws([()] * len(values))
    for name, column in zip((*ARM, "delay"), (*values.T, delays), strict=True):
        getattr(physics, name)[:] = column
    return physics


def _likelihood(misses: Array) -> Array:
    """Log-likelihood of each hypothesis, scaled by what even the best cannot explain."""
    errors = np.asarray((misses ** 2).sum(axis=3), np.float64)
    least = np.asarray(errors.min(axis=2), np.float64)
    scale = float(np.median(least[:, np.median(least, axis=0).argmin()])) / 6 + 1e-12
    mixed = (1 - LATE) * np.exp(-errors[..., 0] / scale) + LATE * np.exp(-errors[..., 1] / scale)
    return np.log(mixed + 1e-12).sum(axis=0)


AWAY = (-0.5, 0.0, 0.02, 0.0)
"""Where the cube lies meanwhile: x, y, z [m], yaw [rad]."""


def _misses(ticks: Sequence[_Tick], tried: Physics, world: World) -> Array:
    """By how much each hypothesis misses the joints [rad] and their scaled speeds a tick later, on time and late.

    Returns:
        Shape (ticks, hypotheses, 2, 12).
    """
    m = len(tried.kp)
    own = tried.take(np.tile(np.arange(m), 2))
    own.jitter[m:] = 1.0
    per = world.n // (2 * m)
    ids = np.arange(2 * m * per)
    world.restart(ids, [world.scenes[0]] * len(ids), own.take(np.tile(np.arange(2 * m), per)))
    parts = [_one_tick(ticks[k:k + per], tried, world) for k in range(0, len(ticks), per)]
    return np.concatenate(parts)


def _one_tick(here: Sequence[_Tick], tried: Physics, world: World) -> Array:
    """Play some of the experiments; places are ordered by tick, then late or not, then hypothesis."""
    m = len(tried.kp)
    ids, rng = np.arange(len(here) * 2 * m), np.random.default_rng(0)  # no hypothesis has jitter: nothing is drawn

    def spread(values: list[Array]) -> Array:
        return np.repeat(np.stack(values), 2 * m, axis=0)

    memories = [memory(t.log, t.tick, played(t.log, tried, rng, t.tick)[-1], 0) for t in here]
    rows = np.concatenate([np.tile(rows, (2, 1)) for rows in memories])
    rows[:, -3] = 0  # an attempt of a person may be longer than the task's own time
    world.place_arm(ids, spread([t.log.joints[t.tick] for t in here]),
                    spread([t.log.joint_velocity[t.tick] for t in here]))
    world.place_cube(ids, np.tile(AWAY, (len(ids), 1)), np.zeros((len(ids), 3)))
    world.load(ids, world.save(ids)[0], rows)
    world.act(spread([t.log.action[t.tick] for t in here]), ids)
    joints, speeds = world.observe(ids).state[:, :6], world.speeds(ids)[:, :6]
    missed = np.column_stack([joints - spread([t.log.joints[t.tick + 1, :6] for t in here]),
                              SPEED_SCALE_S * (speeds - spread([t.log.joint_velocity[t.tick + 1, :6] for t in here]))])
    return missed.reshape(len(here), 2, m, 12).transpose(0, 2, 1, 3)
