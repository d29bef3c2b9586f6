"""Triggers: what a robot notices of its own failures, from its own senses alone."""

from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import STATE
from pipeline.protocols import Array, Ids, Observation, Trigger
from schemas.recipe import HarvestConfig

if TYPE_CHECKING:
    from pipeline.simulation.tasks import PickPlace

GRIPPED_M, FAR_M, SETTLE_TICKS = 0.016, 0.06, 3
"""Finger opening above which something is held, object to tool beyond which it is not, ticks until believed."""
LOW_M = 0.012
"""Perceived height above rest that still counts as on the table [m]: six standard deviations of the noise."""

_OPENING, _ASKED = STATE.index("gripper"), STATE.index("cmd_gripper")
_TOOL = slice(STATE.index("ee_x"), STATE.index("ee_z") + 1)


class Senses:
    """Running counts of what n robots perceive; rows are attempts.

    Args:
        n: attempts.
        ticks: longest attempt.
        config: thresholds.
        within_m, away_m, open_m, low_m, hold: the task's success as far as it can be perceived.
    """

    def __init__(self, n: int, ticks: int, config: HarvestConfig, *, within_m: float, away_m: float, open_m: float,
                 low_m: float, hold: int) -> None:
        self.config, self._ticks = config, ticks
        self._within, self._away, self._open, self._low, self._hold = within_m, away_m, open_m, low_m, hold
        self._anchor = np.full((n, 3), np.inf)
        self._rest = np.full(n, np.inf)
        self.tick = np.zeros(n, int)
        self.still = np.zeros(n, int)
        self.empty = np.zeros(n, int)
        self.gripping = np.zeros(n, int)
        self.gripped = np.zeros(n, bool)
        self.lost = np.zeros(n, int)
        self.released = np.zeros(n, bool)
        self.differing = np.zeros(n, int)
        self._done = np.zeros(n, int)

    def update(self, observation: Observation, ids: Ids) -> None:
        """Take in what was perceived at one tick."""
        state, seen = observation.state, observation.environment
        tool, cube, opening = state[:, _TOOL], seen[:, :3], state[:, _OPENING]
        first = self.tick[ids] == 0
        self._rest[ids] = np.where(first, cube[:, 2], self._rest[ids])
        moved = np.linalg.norm(tool - self._anchor[ids], axis=1) > self.config.stall_progress_m
        self._anchor[ids] = np.where(moved[:, None], tool, self._anchor[ids])
        self.still[ids] = np.where(moved, 0, self.still[ids] + 1)
        closing = state[:, _ASKED] < 0.04
        near = np.linalg.norm(tool - cube, axis=1) < FAR_M
        self.empty[ids] = np.where(closing & (opening < self.config.closed_gap_m), self.empty[ids] + 1, 0)
        self.gripping[ids] = np.where(closing & near & (opening > GRIPPED_M), self.gripping[ids] + 1, 0)
        self.gripped[ids] |= self.gripping[ids] >= SETTLE_TICKS
        self.lost[ids] = np.where(self.gripped[ids] & closing & ~near, self.lost[ids] + 1, 0)
        self.released[ids] |= self.gripped[ids] & ~closing
        at = np.hypot(*(cube[:, :2] - seen[:, 4:6]).T) < self._within
        low = cube[:, 2] < self._rest[ids] + self._low
        away = np.linalg.norm(tool - cube, axis=1) > self._away
        self._done[ids] = np.where(at & low & away & (opening > self._open), self._done[ids] + 1, 0)
        self.tick[ids] += 1

    def differ(self, apart: Array, ids: Ids) -> None:
        """Take in how far the candidates in the champion's shadow are from it, as pipeline.signals tells it.

        Args:
            apart: disagreement with the nearest candidate that answered, shape (len(ids),); at a tick at which it is
                NaN nobody answered, and the count stands still.
            ids: the attempts.
        """
        if self.config.disagreement is not None:
            grown = np.where(apart > self.config.disagreement.apart, self.differing[ids] + 1, 0)
            self.differing[ids] = np.where(np.isnan(apart), self.differing[ids], grown)

    def succeeded(self, ids: Ids) -> NDArray[np.bool_]:
        """As far as the robot can tell: object on the mark and let go, for the hold time."""
        return self._done[ids] >= self._hold

    def timed_out(self) -> NDArray[np.bool_]:
        """Attempts at their last tick, shape (n,)."""
        return self.tick >= self._ticks

    def phase(self, attempt: int) -> str:
        """Subtask the attempt has reached: reach, carry or place."""
        return "place" if self.released[attempt] else "carry" if self.gripped[attempt] else "reach"


def senses_of(task: "PickPlace", n: int, config: HarvestConfig, *, ticks: int | None = None) -> Senses:
    """Senses for n attempts at a task that may take `ticks`, the task's own where None."""
    return Senses(n, task.ticks if ticks is None else ticks, config, within_m=task.within_m, away_m=task.hand_away_m,
                  open_m=task.open_m, low_m=LOW_M, hold=task.hold_ticks)


def stall(s: Senses) -> NDArray[np.bool_]:
    """The tool has not moved by `stall_progress_m` for `stall_ticks`."""
    return s.still >= s.config.stall_ticks


def closed_on_nothing(s: Senses) -> NDArray[np.bool_]:
    """The gripper was asked to close and has met nothing for `closed_ticks`; nothing had been held before."""
    return (s.empty > s.config.closed_ticks) & ~s.gripped


def dropped(s: Senses) -> NDArray[np.bool_]:
    """Something was held, the gripper still closes, and the object is no longer between the fingers."""
    return s.gripped & ((s.lost >= SETTLE_TICKS) | (s.empty > s.config.closed_ticks))


def timed_out(s: Senses) -> NDArray[np.bool_]:
    """The attempt has reached its last tick without a success."""
    return s.timed_out()


def disagreement(s: Senses) -> NDArray[np.bool_]:
    """Every candidate that answered has meant something else than the champion for `disagreement.ticks`."""
    if s.config.disagreement is None:
        return np.zeros(len(s.differing), bool)
    return s.differing >= s.config.disagreement.ticks


TRIGGERS: MappingProxyType[str, Trigger] = MappingProxyType({
    "stall": stall, "closed-on-nothing": closed_on_nothing, "dropped": dropped, "timed-out": timed_out,
    "disagreement": disagreement,
})
"""Trigger name -> rule, asked in this order. Add one: a function of Senses and an entry here."""


def fired(senses: Senses, ids: Ids) -> NDArray[np.int64]:
    """Index in TRIGGERS of the first rule that fires, -1 where none does, shape (len(ids),)."""
    out = np.full(len(ids), -1)
    for index, rule in reversed(list(enumerate(TRIGGERS.values()))):
        out[rule(senses)[ids]] = index
    return out


def family(trigger: str, phase: str) -> str:
    """Failure family: what was noticed, and in which subtask."""
    return f"{trigger}-{phase}"


def stratum_of(seen: Array) -> str:
    """Kind of start as the robot perceives it at rest: x, y, z [m] of the object.

    A cube whose centre rests above 25 mm is large; one beyond 17 cm to a side lies beside the robot.
    """
    return "large" if seen[2] > 0.025 else "beside" if abs(seen[1]) > 0.17 else "common"
