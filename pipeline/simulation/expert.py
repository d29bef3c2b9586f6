"""The scripted expert: a demonstrator that decides from what it perceives, so that its habits can be learned."""

import numpy as np

from pipeline.protocols import Array, Ids, Observation
from pipeline.simulation.world import LIMITS, OPEN_M
from schemas.base import Frozen


class ExpertConfig(Frozen):
    """Waypoints and gates [m]; gates near 10 mm, for narrower ones make a learner without memory deadlock."""

    hover: float = 0.10
    carry: float = 0.09
    grasp_z: float = -0.003
    place_z: float = 0.018
    gate: float = 0.011
    funnel: float = 5.0
    speed: float = 0.019
    creep: float = 0.003
    slowing: float = 0.15
    turn: float = 0.11
    arrive: float = 0.012
    integral: float = 0.15
    largest_offset: float = 0.03


class Expert:
    """Feed-forward motion of the commanded pose towards waypoints, plus a slow integral of the standing error.

    Phases follow from the observation alone (0 reach, 1 close, 2 carry, 3 release, 4 retreat); the only memory
    is the integral offset, so that it can take over any attempt at any time.
    """

    PHASES = ("reach", "close", "carry", "release", "retreat")

    def __init__(self, config: ExpertConfig = ExpertConfig()) -> None:
        self.config = config
        self.offset: Array = np.zeros((0, 3))

    def reset(self, n: int) -> None:
        """Forget everything and prepare for n attempts."""
        self.offset = np.zeros((n, 3))
        self.phase = np.zeros(n, int)

    def memory(self, ids: Ids) -> Array:
        """Integral offsets [m], shape (len(ids), 3)."""
        return self.offset[ids]

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Actions (len(ids), 5); see pipeline.frames.ACTION."""
        c, state, seen = self.config, observation.state, observation.environment
        opening, tool, command, asked = state[:, 6], state[:, 7:11], state[:, 11:15], state[:, 15]
        cube, target = seen[:, :3], seen[:, 4:7]
        near = np.linalg.norm(tool[:, :3] - cube, axis=1)
        placed = np.hypot(*(cube - target)[:, :2].T) < 0.02
        closing = asked < 0.5 * OPEN_M
        gripped = closing & (near < 0.030) & (opening > 0.012) & (np.abs(state[:, 6] - asked) > 0.006)
        over = np.hypot(*(tool[:, :2] - cube[:, :2]).T)
        low = np.abs(tool[:, 2] - cube[:, 2] - c.grasp_z) < 0.012
        ready = (over < c.gate) & low
        resting = cube[:, 2] < 0.05
        at_goal = np.hypot(*(tool[:, :2] - target[:, :2]).T) < c.gate
        phase = np.zeros(len(ids), int)
        phase[ready & ~placed] = 1
        phase[gripped] = 2
        down = gripped & at_goal & placed & (np.abs(tool[:, 2] - c.place_z) < 0.010)
        phase[down] = 3
        phase[placed & ~gripped & resting] = 4
        goal, want = self._goals(phase, tool, command, cube, target, seen[:, 3])
        self.phase[ids] = phase
        return self._move(goal, want, tool, command, ids)

    def _goals(self, phase: Array, tool: Array, command: Array, cube: Array, target: Array,
               cube_yaw: Array) -> tuple[Array, Array]:
        c = self.config
        goal, want = np.empty((len(phase), 4)), np.full(len(phase), OPEN_M)
        goal[:, :2] = cube[:, :2]
        away = np.hypot(*(command[:, :2] - cube[:, :2]).T)
        goal[:, 2] = cube[:, 2] + c.grasp_z + np.minimum(c.hover, c.funnel * np.maximum(0, away - c.gate))
        goal[:, 3] = cube_yaw
        closing, carrying, letting, leaving = (phase == k for k in (1, 2, 3, 4))
        goal[closing, :2] = command[closing, :2]
        want[closing | carrying] = 0.0
        away = np.hypot(*(command[:, :2] - target[:, :2]).T)
        height = c.place_z + np.minimum(c.carry, c.funnel * np.maximum(0, away - c.gate))
        goal[carrying, :2], goal[carrying, 2] = target[carrying, :2], height[carrying]
        goal[carrying | letting | leaving, 3] = command[carrying | letting | leaving, 3]
        # A cube is lifted before it is moved: it would scrape over the table otherwise.
        low = carrying & (tool[:, 2] < 0.05) & (away > 0.05)
        goal[low, :2] = command[low, :2]
        goal[letting, :3] = command[letting, :3]
        goal[leaving, :2], goal[leaving, 2] = command[leaving, :2], c.place_z + c.hover
        return goal, want

    def _move(self, goal: Array, want: Array, tool: Array, command: Array, ids: Ids) -> Array:
        c = self.config
        step = goal.copy()
        step[:, :3] += self.offset[ids] - command[:, :3]
        step[:, 3] -= command[:, 3]
        still = np.linalg.norm(step[:, :3], axis=1) < 0.004
        error = np.clip(goal[:, :3] - tool[:, :3], -0.02, 0.02)
        offset = self.offset[ids] + c.integral * np.where(still[:, None], error, 0.0)
        self.offset[ids] = np.clip(offset, -c.largest_offset, c.largest_offset)
        length = np.linalg.norm(step[:, :3], axis=1, keepdims=True)
        speed = np.minimum(c.speed, c.creep + c.slowing * length)
        step[:, :3] *= np.minimum(1.0, speed / np.maximum(length, 1e-9))
        step[:, 3] = np.clip(step[:, 3], -c.turn, c.turn)
        return np.column_stack([np.clip(step, -LIMITS, LIMITS), want])
