"""State: where robot and object may have been at a moment, as weighed guesses that explain what was sensed before.

The arm's joints and their speeds are measured, and the lower controller is ours: both are known. The object is
guessed where it can be told well (estimate_object), under physics that the robot may have, and what was sent from
there on is played to the moment while the simulated arm is held to the measured one. Guesses that perceive something
else than what was perceived weigh less. One guess more is played without holding the arm: it tells the replay error.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.counterfactual.estimate_log import TOOL, SensedLog
from pipeline.counterfactual.estimate_memory import memory, played
from pipeline.counterfactual.estimate_object import Told, told
from pipeline.counterfactual.estimate_robot import Robot
from pipeline.counterfactual.moment import Lab
from pipeline.protocols import Array, Ids
from pipeline.simulation.physics import Physics
from pipeline.simulation.world import World
from pipeline.triggers import FAR_M
from schemas.scene import SceneSpec

GUESSES = 32
"""Guesses of each moment."""
MODEL_SD_M = 0.002
"""How well a replayed object can be expected to follow the real one [m]."""
PLACES = 1024


@dataclass(frozen=True, slots=True)
class Sought:
    """One moment whose state is sought."""

    scene: SceneSpec
    """Of the attempt as it was perceived; its seed is that of all draws."""
    log: SensedLog
    tick: int


@dataclass(frozen=True, slots=True)
class Guessed:
    """Guesses of the state at one moment, the likely ones more often; g of them."""

    physics: Physics
    """g rows."""
    engine: Array
    """State of the engine, shape (g, nstate)."""
    controller: Array
    """Shape (g, CONTROLLER_WIDTH)."""
    joints_rad: float
    """Replay error: RMS of the joints over the replay, no guess held to the measured arm [rad]."""
    object_m: float
    """Replay error: RMS of the perceived object's distance over the replay, perception noise included [m]."""


def guess(sought: Sequence[Sought], robot: Robot, lab: Lab) -> list[Guessed]:
    """Estimate the state at each moment.

    Args:
        sought: moments of one robot.
        robot: what is believed of it.
        lab: the simulation that stands in for it.

    Source: Gordon, Salmond and Smith 1993, IEE Proceedings F 140:107 (bootstrap filter); systematic resampling:
    Kitagawa 1996, Journal of Computational and Graphical Statistics 5:1.
    """
    size = PLACES // (GUESSES + 1)
    return [g for k in range(0, len(sought), size) for g in _guessed(sought[k:k + size], robot, lab)]


def _guessed(sought: Sequence[Sought], robot: Robot, lab: Lab) -> list[Guessed]:
    each = GUESSES + 1
    starts = [told(s.log, s.tick, s.scene.object_half_m) for s in sought]
    rngs = [np.random.default_rng([s.scene.seed, 37]) for s in sought]
    physics = [robot.draw(each, rng) for rng in rngs]
    seeds = [rng.integers(1 << 62, size=each).tolist() for rng in rngs]
    scenes = [s.scene.model_copy(update={"seed": seed}) for s, own in zip(sought, seeds, strict=True) for seed in own]
    world = lab.world(scenes, [()] * len(scenes))
    ids = np.arange(world.n)
    world.restart(ids, scenes, _stacked(physics))
    for i, (s, start) in enumerate(zip(sought, starts, strict=True)):
        _begin(world, ids[i * each:(i + 1) * each], s, start, physics[i], robot, rngs[i])
    replay = _Replay(world, sought, starts, each)
    replay.run()
    engine, controller = world.save(ids)
    return [_resampled(replay, i, physics[i], engine, controller, rngs[i]) for i in range(len(sought))]


def _begin(world: World, ids: Ids, sought: Sought, start: Told, physics: Physics, robot: Robot,
           rng: np.random.Generator) -> None:
    log, tick, n = sought.log, start.tick, len(ids)
    biases = np.column_stack([physics.bias_x, physics.bias_y])
    cubes = start.draw(log, biases, robot.eyes, robot.middle_m, rng)
    speed = (log.state[tick, TOOL] - log.state[max(tick - 1, 0), TOOL]) * world.control_hz * start.held
    world.place_arm(ids, np.tile(log.joints[tick], (n, 1)), np.tile(log.joint_velocity[tick], (n, 1)))
    world.place_cube(ids, cubes, np.tile(speed, (n, 1)))
    play = played(log, physics, rng, tick)[-1]
    world.load(ids, world.save(ids)[0], memory(log, tick, play, 0))


class _Replay:
    """Plays what was sent from the starts to the moments; the last place of each moment is never held to the log."""

    def __init__(self, world: World, sought: Sequence[Sought], starts: Sequence[Told], each: int) -> None:
        self._world, self._sought, self._each = world, sought, each
        self._tick = np.repeat([s.tick for s in starts], each)
        self._stop = np.repeat([s.tick for s in sought], each)
        self._free = np.arange(world.n) % each == each - 1
        self.ticks = self._stop - self._tick
        self.joints, self.objects, self.weight = np.zeros(world.n), np.zeros(world.n), np.zeros(world.n)
        """Sums over the replay of squared misses [rad^2 a joint, m^2], and log-weights."""

    def run(self) -> None:
        """To the moments, each as long as it takes."""
        ids = np.flatnonzero(self._tick < self._stop)
        while ids.size:
            self._world.act(self._rows("action", ids), ids)
            self._tick[ids] += 1
            self._compare(ids)
            self._hold(ids[~self._free[ids]])
            ids = ids[self._tick[ids] < self._stop[ids]]

    def _rows(self, name: str, ids: Ids) -> Array:
        rows: list[int] = ids.tolist()
        return np.stack([getattr(self._sought[i // self._each].log, name)[self._tick[i]] for i in rows])

    def _compare(self, ids: Ids) -> None:
        seen, state, there = self._world.observe(ids), self._rows("state", ids), self._rows("environment", ids)
        self.joints[ids] += ((seen.state[:, :6] - state[:, :6]) ** 2).mean(axis=1)
        miss = ((seen.environment[:, :3] - there[:, :3]) ** 2).sum(axis=1)
        self.objects[ids] += miss
        noise = self._world.physics.noise[ids] ** 2
        self.weight[ids] -= 0.5 * miss / (2 * noise + MODEL_SD_M ** 2)  # both the log and the replay are noisy

    def _hold(self, ids: Ids) -> None:
        """Put arms where the real one was; what they hold comes along."""
        if not ids.size:
            return
        world, before = self._world, self._world.observe(ids)
        near = np.linalg.norm(before.state[:, TOOL] - world.truth(ids)[:, :3], axis=1) < FAR_M / 2
        held = near & (before.state[:, 6] < 2 * world.half(ids) + 0.004)
        world.place_arm(ids, self._rows("joints", ids), self._rows("joint_velocity", ids))
        world.shift_cube(ids, (self._rows("state", ids)[:, TOOL] - before.state[:, TOOL]) * held[:, None])


def _resampled(replay: _Replay, moment: int, physics: Physics, engine: Array, controller: Array,
               rng: np.random.Generator) -> Guessed:
    first = moment * (GUESSES + 1)
    ids = np.arange(first, first + GUESSES)
    weight = np.exp(replay.weight[ids] - replay.weight[ids].max())
    weight /= weight.sum()
    rows = np.searchsorted(np.cumsum(weight), (np.arange(GUESSES) + rng.random()) / GUESSES).clip(0, GUESSES - 1)
    rows = rng.permutation(rows)
    ticks = max(1, int(replay.ticks[first]))
    object_m = float(np.sqrt((weight * replay.objects[ids]).sum() / ticks))
    return Guessed(physics.take(rows), engine[ids[rows]], controller[ids[rows]],
                   float(np.sqrt(replay.joints[first + GUESSES] / ticks)), object_m)


def _stacked(parts: Sequence[Physics]) -> Physics:
    return Physics(*(np.concatenate([getattr(p, name) for p in parts]) for name in Physics.__slots__))
