"""Variants of a recorded attempt: its commands replayed as they were, or carried over to another start.

Object-centric retargeting after Mandlekar et al., "MimicGen" (CoRL 2023), for commanded poses: up to the grasp the
path is kept relative to the object, from there relative to the target, and what the two frames disagree about
is blended out along the way.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SimulationError
from pipeline.frames import Frames
from pipeline.protocols import Array, Ids, Observation
from pipeline.simulation.world import LIMITS, OPEN_M

SPEED_M, TURN_RAD = 0.019, 0.11
"""Longest step of a retargeted path a tick: just below the controller's limits."""
ARRIVED_M, PATIENCE = 0.012, 25
"""Distance of the tool to its command at which a waiting gripper acts, and the longest wait [ticks]."""
SETTLED_M = 0.0015
"""Change of the finger opening a tick below which a grip counts as settled."""
LIFTED_M = 0.02
"""Rise of the object that counts as lifted [m]."""


class Playback:
    """A policy that sends recorded actions; the gripper waits for the tool, and the tool for the gripper.

    Under other physics the tool lags more or less behind its command. Actions sent by the clock alone would teach
    a learner to close at a time; paced ones teach it to close at a place, as the demonstrator does.

    Args:
        actions: one (m, 5) array an attempt.
        paced: wait at each change of the gripper; False sends by the clock alone.
    """

    def __init__(self, actions: list[Array], *, paced: bool = True) -> None:
        longest = max(len(a) for a in actions)
        self._table = np.zeros((len(actions), longest + 1, 5))
        self._last = np.array([len(a) for a in actions])
        for row, action in enumerate(actions):
            self._table[row, :len(action)] = action
            self._table[row, len(action):, 4] = action[-1, 4]
        self._paced = paced
        self.reset(len(actions))

    def reset(self, n: int) -> None:
        """Begin at the first action."""
        self._tick, self._waited = np.zeros(n, int), np.zeros(n, int)
        self._opening = np.full(n, np.nan)

    def act(self, observation: Observation, ids: Ids) -> Array:
        """The recorded action of each attempt's place in its recording, or a pause with the gripper as it is."""
        state = observation.state
        tick = np.minimum(self._tick[ids], self._last[ids])
        action = self._table[ids, tick]
        lag = np.linalg.norm(state[:, 7:10] - state[:, 11:14], axis=1)
        turning = np.abs(action[:, 4] - state[:, 15]) > OPEN_M / 4
        moving = np.linalg.norm(action[:, :3], axis=1) > 1e-3
        settled = np.abs(state[:, 6] - self._opening[ids]) < SETTLED_M
        grip_open = np.abs(state[:, 6] - state[:, 15]) < 0.004
        wait = self._paced & (self._waited[ids] < PATIENCE)
        wait &= (turning & (lag > ARRIVED_M)) | (~turning & moving & ~settled & ~grip_open)
        self._opening[ids] = state[:, 6]
        self._waited[ids] = np.where(wait, self._waited[ids] + 1, 0)
        self._tick[ids] += ~wait
        action[wait, :4], action[wait, 4] = 0.0, state[wait, 15]
        return action

    def memory(self, ids: Ids) -> Array:
        """Place in the recording, ticks waited, last opening; shape (len(ids), 3)."""
        return np.column_stack([self._tick[ids], self._waited[ids], self._opening[ids]])


@dataclass(frozen=True, slots=True)
class Path:
    """A commanded path of one demonstration; rows are ticks."""

    pose: Array
    """Commanded x, y, z [m] and yaw [rad] before the first and after each action, shape (m + 1, 4)."""
    opening: Array
    """Finger opening asked for [m], shape (m,)."""
    grasp: int
    """Tick of the first closing action."""
    object: Array
    """Object as perceived at the grasp: x, y, yaw."""
    target: Array
    """Target x, y."""


def path_of(frames: Frames, where: str) -> Path:
    """The commanded path of a whole demonstration.

    The grasp is the last closing of the gripper before the object is lifted: there may have been one in vain.

    Args:
        frames: the demonstration, from where every attempt begins.
        where: named in the error.

    Raises:
        SimulationError: nothing is grasped and lifted.
    """
    closed = frames.action[:, 4] < OPEN_M / 2
    lifted = np.flatnonzero(frames.environment[:, 2] - frames.environment[0, 2] > LIFTED_M)
    turns = np.flatnonzero(closed & ~np.concatenate([[False], closed[:-1]]))
    turns = turns[turns < (lifted[0] if lifted.size else 0)]
    if not turns.size:
        raise SimulationError("nothing is grasped and lifted", where=where,
                              mend="leave it out of retargeting: only attempts that grasp can be carried over")
    grasp = int(turns[-1])
    pose = np.concatenate([frames.state[:, 11:15], frames.state[-1:, 11:15] + frames.action[-1:, :4]]).astype(float)
    return Path(pose, frames.action[:, 4].astype(float), grasp, frames.environment[grasp, [0, 1, 3]].astype(float),
                frames.environment[0, 4:6].astype(float))


def _fade(xy: Array) -> Array:
    """Weight of what two frames disagree about: 1 at the first row, 0 at the last, by the way covered, shape (k, 1).

    Bending along the whole way teaches more than keeping the last centimetres as shown and bending before: that
    gave 60 to 76 % on twins 2-4 where this gives 86 to 88.
    """
    way: Array = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    if way[-1] < 1e-6:
        way = np.linspace(0, 1, len(xy), dtype=np.float64)
    return (1 - way / way[-1])[:, None]


def retarget(path: Path, start: Array, seen: Array, target: Array) -> Array:
    """Actions that carry a demonstration over to another start.

    Args:
        path: the demonstration.
        start: commanded pose at the new start: x, y, z [m], yaw [rad].
        seen: object as perceived there: x, y [m], yaw [rad].
        target: target there: x, y [m].

    Returns:
        Actions, shape (k, 5); k differs from the demonstration's where the way is longer.
    """
    g, pose = path.grasp, path.pose
    turn = (seen[2] - path.object[2] + np.pi / 4) % (np.pi / 2) - np.pi / 4
    c, s = np.cos(turn), np.sin(turn)
    spin = np.array([[c, -s], [s, c]])
    reach = pose[:g + 1].copy()
    reach[:, :2] = (reach[:, :2] - path.object[:2]) @ spin.T + seen[:2]
    reach[:, 3] += turn
    reach += _fade(pose[:g + 1, :2]) * (start - reach[0])
    carry = pose[g:].copy()
    carry[:, :2] += target - path.target
    carry[:, 3] += reach[-1, 3] - carry[0, 3]
    carry[:, :2] += _fade(pose[g:, :2]) * (reach[-1, :2] - carry[0, :2])
    return _timed(np.concatenate([reach, carry[1:]]), path.opening)


def _timed(pose: Array, opening: Array) -> Array:
    """Actions along a path whose steps are divided where they would be too fast."""
    step = np.diff(pose, axis=0)
    parts = np.maximum(np.linalg.norm(step[:, :3], axis=1) / SPEED_M, np.abs(step[:, 3]) / TURN_RAD)
    count = np.maximum(1, np.ceil(parts - 1e-9)).astype(int)
    actions = np.column_stack([step / count[:, None], opening])
    return np.clip(np.repeat(actions, count, axis=0), [*-LIMITS, 0], [*LIMITS, OPEN_M])


def survival(parents: list[str], success: NDArray[np.bool_]) -> dict[str, float]:
    """Demonstration id -> share of its variants that succeeded."""
    names = np.array(parents)
    return {str(n): float(success[names == n].mean()) for n in np.unique(names)}
