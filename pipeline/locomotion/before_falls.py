"""Falls in simulation, and where the robots stood some time before them: what a policy still has to learn."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.starts import Start
from pipeline.locomotion.tasks import LeggedTask
from pipeline.locomotion.trying import Act, trying
from pipeline.locomotion.world import LeggedWorld

BEFORE_S = 0.6
"""How long before a fall a hard start lies [s], as in the loop's harvest. Who fell sooner gives the start itself."""


@dataclass(frozen=True, slots=True)
class Played:
    """n attempts from given starts."""

    full: NDArray[np.bool_]
    """Which reached the end, shape (n,)."""
    length: NDArray[np.int64]
    """Ticks until the fall, or all, shape (n,)."""
    before: dict[int, Start]
    """Attempt that fell -> where it was BEFORE_S earlier, without blows."""


def play_from(act: Act, body: LeggedBody, task: LeggedTask, starts: Sequence[Start], *, ticks: int | None = None,
              before_s: float = BEFORE_S, threads: int = 1) -> Played:
    """Play attempts from these starts to their ends, and keep the states before falls.

    Args:
        act: the policy.
        body, task: what is done.
        starts: one an attempt, blows included.
        ticks: how long; as long as the task where None.
        before_s: how long before a fall [s].
        threads: threads of the engine.
    """
    n, back = len(starts), max(1, round(before_s * task.control_hz))
    world = LeggedWorld(body, task, n, threads=threads)
    everyone = np.arange(n)
    world.restart(everyone, starts)
    alive, length = np.ones(n, bool), np.zeros(n, np.int64)
    past, before = deque([world.as_starts(everyone)], maxlen=back + 1), dict[int, Start]()
    for tried in trying(act, world, ticks or task.ticks):
        before |= {int(i): past[0][i] for i in np.flatnonzero(alive & ~tried.stands)}
        alive = tried.stands
        length += alive
        past.append(world.as_starts(everyone))
    return Played(alive, length, before)
