"""LeggedPlant: n legged robots that are driven at any rate which the engine's steps allow."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.control.parts import Memory
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.evaluation import evaluation_seed
from pipeline.locomotion.rewards import Motion
from pipeline.locomotion.starts import Start, draw_start
from pipeline.locomotion.tasks import LeggedTask
from pipeline.locomotion.world import LeggedWorld, heading_of
from pipeline.protocols import Array


@dataclass(frozen=True, slots=True)
class LeggedSensed:
    """What the parts of a hierarchy may know of n legged robots."""

    observation: NDArray[np.float32]
    """As LeggedWorld.observe gives it, but for the command: a lower puts its own there. Shape (n, w)."""
    position: Array
    """Where the bases are over ground [m], shape (n, 2): a simulator's truth, in place of a robot's odometry."""
    heading: Array
    """Where they look, anticlockwise from x [rad], shape (n,)."""
    world: Memory
    """The simulator's whole state, see LeggedWorld.save: no robot has it; only a lower that plans looks at it."""


class LeggedPlant:
    """n robots of one task whose control clock is the engine's.

    Args:
        body, task: as for LeggedWorld; the task's control rate is that of its policies, not of this plant.
        starts: of each robot, drawn for `at_every_step(task)`.
        threads: threads of the engine; results do not depend on them.
    """

    def __init__(self, body: LeggedBody, task: LeggedTask, starts: Sequence[Start], *, threads: int = 1) -> None:
        self.body, self.task, self.n, self.threads = body, task, len(starts), threads
        self.world = LeggedWorld(body, at_every_step(task), self.n, threads=threads)
        self.clock_hz = self.world.task.control_hz
        self.world.restart(np.arange(self.n), starts)

    def rest(self) -> Array:
        """The action that asks nothing of any joint, shape (n, joints)."""
        return np.zeros((self.n, self.world.action_size))

    def sense(self) -> LeggedSensed:
        """What the robots sense, where they are, and all of the state."""
        saved = self.world.save()
        quaternion = self.world.orientation()
        forward = heading_of(quaternion)
        return LeggedSensed(self.world.observe(), self.world.position()[:, :2],
                            np.arctan2(forward[:, 1], forward[:, 0]), saved)

    def act(self, action: Array, steps: int) -> None:
        """Hold shares in [-1, 1], shape (n, joints), for some steps of the engine."""
        for _ in range(steps):
            self.world.act(action)

    def motion(self) -> Motion:
        """What truly happens, for judges; its command is not the hierarchy's."""
        return self.world.motion()

    def save(self) -> Memory:
        """See LeggedWorld.save."""
        return self.world.save()

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        self.world.load(memory)


def at_every_step(task: LeggedTask) -> LeggedTask:
    """The same task on a control clock as fast as the engine's steps."""
    return task.model_copy(update={"control_hz": task.control_hz * task.substeps, "substeps": 1})


def legged_plant(body: LeggedBody, task: LeggedTask, n: int, *, seed: int, stratum: str | None = None,
                 threads: int = 1) -> LeggedPlant:
    """n robots at starts that no training meets."""
    kind, fine = stratum or next(iter(task.starts)), at_every_step(task)
    starts = [draw_start(fine, body, kind, evaluation_seed(seed, k)) for k in range(n)]
    return LeggedPlant(body, task, starts, threads=threads)
