"""LeggedRobots: n legged robots as the loop knows robots; what their senses and motors lack is a value beside them."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SimulationError
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.delay import DelayLine
from pipeline.locomotion.scenes import starts_of
from pipeline.locomotion.tasks import LeggedTask
from pipeline.locomotion.world import SPEED_SCALE, TURN_SCALE, LeggedWorld
from pipeline.protocols import Array, Ids, Observation
from pipeline.simulation.scenes import NOMINAL, Contact, add_scene
from schemas.scene import SceneSpec


@dataclass(frozen=True, slots=True)
class Quirks:
    """What senses, motors and surroundings of a robot do that training does not know; nothing by default."""

    delay_steps: int = 0
    """How late the motors hear of a command [steps of the engine]."""
    turning_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the gyroscope [rad/s]."""
    turning_noise: float = 0.0
    """Standard deviation of the gyroscope, each tick [rad/s]."""
    tilt_bias: tuple[float, float] = (0.0, 0.0)
    """How the IMU is mounted: about x, about y [rad]."""
    tilt_noise: float = 0.0
    """Standard deviation of the IMU's up, each tick and axis [rad]."""
    joint_bias: float = 0.0
    """Standard deviation of the encoders' zeros, one draw a joint [rad]."""
    joint_noise: float = 0.0
    """Standard deviation of the encoders, each tick [rad]."""
    rate_noise: float = 0.0
    """Standard deviation of the joint speeds, each tick [rad/s]."""
    blows: float = 1.0
    """Factor on what pushes the robot [1]."""
    seed: int = 0
    """Of the encoders' zeros."""


@dataclass(frozen=True, slots=True)
class LeggedSetup:
    """A legged robot in its scene: what a recording keeps of it, see pipeline.simulation.recordings.record."""

    body: LeggedBody
    model: mujoco.MjModel
    xml: str


class LeggedRobots:
    """n robots on one control clock; implements pipeline.protocols.Robot.

    Args:
        body: the robot as it really is.
        task: what they are to do.
        scenes: start of each attempt.
        quirks: of senses, motors and surroundings.
        contact: contact model of the ground.
        threads: threads of the engine; results do not depend on them.
    """

    def __init__(self, body: LeggedBody, task: LeggedTask, scenes: Sequence[SceneSpec], *,
                 quirks: Quirks | None = None, contact: Contact = NOMINAL, threads: int = 1) -> None:
        self.body, self.task, self.scenes, self.n = body, task, tuple(scenes), len(scenes)
        self.quirks, self.control_hz = quirks or Quirks(), task.control_hz
        self.world = LeggedWorld(body, task, self.n, threads=threads, contact=contact)
        self.batch, n, j = self.world.batch, self.n, len(body.joints)
        self.setup = LeggedSetup(body, self.world.model, _xml(body, contact))
        self.efforts = self.batch.bind("actuator_force")
        """Actuator forces of the last step [N m], shape (n, j); valid until the next call of the engine."""
        self._zeros = self.quirks.joint_bias * np.random.default_rng([self.quirks.seed, 0x0E2C]).standard_normal(j)
        self._line = DelayLine(np.full(n, self.quirks.delay_steps), task.substeps, j)
        self.fell = np.zeros(n, bool)
        """Truth: which have fallen so far."""
        ticks = task.ticks + 1
        self._noise = np.stack([np.random.default_rng([s.seed, 7]).standard_normal((ticks, 6 + 2 * j))
                                for s in scenes]).astype(np.float32)
        self._sent = np.zeros((n, j))
        factor = self.quirks.blows * np.array([0, 1, 1]) + np.array([1, 0, 0])
        self.world.restart(np.arange(n), [replace(s, blows=s.blows * factor) for s in starts_of(scenes, body)])

    # -- perceiving -------------------------------------------------------------------------------------------------

    def observe(self, ids: Ids) -> Observation:
        """What the robots sense now, as LeggedWorld.observe tells it, with the faults of their sensors."""
        state = self.world.observe()[ids]
        q, j = self.quirks, len(self.body.joints)
        noise = self._noise[ids, self.world.ticks[ids]]
        state[:, :3] += TURN_SCALE * (np.array(q.turning_bias) + q.turning_noise * noise[:, :3])
        tilt = np.array(q.tilt_bias) + q.tilt_noise * noise[:, 3:5].astype(np.float64)
        if tilt.any():
            state[:, 3:6] = _tilted(state[:, 3:6], tilt)
        state[:, 6:6 + j] += self._zeros + q.joint_noise * noise[:, 6:6 + j]
        state[:, 6 + j:6 + 2 * j] += SPEED_SCALE * q.rate_noise * noise[:, 6 + j:]
        return Observation(state.astype(np.float64), np.zeros((len(ids), 0)))

    def speeds(self, ids: Ids) -> Array:
        """Joint speeds, true [rad/s], shape (len(ids), j)."""
        return self.world.rates(ids)

    # -- acting -----------------------------------------------------------------------------------------------------

    def act(self, action: Array, ids: Ids) -> None:
        """Send actions, shares in [-1, 1] of shape (len(ids), j), and let one control period pass.

        Raises:
            SimulationError: another shape, or a value that is not finite.
        """
        shape, whole = (len(ids), len(self.body.joints)), np.isfinite(action).all()
        if action.shape != shape or not whole:
            raise SimulationError(f"action of shape {action.shape}, the robots take {shape}" if whole else
                                  "action holds a value that is not finite", where=f"{len(ids)} legged robots",
                                  mend="use a policy of this robot: one finite share in [-1, 1] for each of "
                                       f"{', '.join(self.body.joints)}")
        asked = np.clip(action, -1.0, 1.0)
        self._line.ask(asked, ids)
        self.world.act_on(ids, asked, [(self.world.targets(share), steps) for share, steps in self._line.heard(ids)])
        self._sent[ids] = self.world.targets(asked)
        self.fell[ids] |= self.world.fallen(self.world.motion())[ids]

    def sent(self, ids: Ids) -> Array:
        """Joint targets [rad] or torques [N m] that were sent last, shape (len(ids), j)."""
        return self._sent[ids]

    def would_send(self, action: Array, ids: Ids) -> Array:
        """What an action would send; nothing moves, shape (len(ids), j)."""
        del ids
        return self.world.targets(np.clip(action, -1.0, 1.0))

    # -- judging ----------------------------------------------------------------------------------------------------

    def succeeded(self, ids: Ids) -> NDArray[np.bool_]:
        """Truth: which have not fallen so far."""
        return ~self.fell[ids]

    def rewards(self, ids: Ids) -> dict[str, Array]:
        """Reward terms of the tick just passed, weights applied, each (len(ids),)."""
        return {name: values[ids] for name, values in self.world.rewards(self.world.motion()).items()}

    # -- restoring --------------------------------------------------------------------------------------------------

    def save(self, ids: Ids) -> tuple[Array, Array]:
        """State rows: the engine's (mjSTATE_INTEGRATION), and the rest that a restore needs."""
        world, k = self.world, len(ids)
        rest = np.column_stack([world.action[ids], world.previous[ids], self._line.asked[ids].reshape(k, -1),
                                world.clock(ids), self.fell[ids]])
        return self.batch.state[ids].copy(), rest.astype(np.float64)

    def load(self, ids: Ids, rows: Array, rest: Array) -> None:
        """Go on from what `save` gave, bit for bit; blows and noise are those of the scenes.

        Raises:
            SimulationError: states of another robot or task.
        """
        j, line = len(self.body.joints), self._line.asked[0].size
        wanted = (self.batch.state.shape[1], 2 * j + line + 3)
        if (found := (rows.shape[1], rest.shape[1])) != wanted:
            raise SimulationError(f"state of {found[0]} and {found[1]} values, this robot has {wanted[0]} and "
                                  f"{wanted[1]}", where="restore",
                                  mend="restore with the robot, task and twin that the recording names")
        self.batch.state[ids] = rows
        world, (action, previous, asked, clock, fell) = self.world, np.split(
            rest, [j, 2 * j, 2 * j + line, 2 * j + line + 2], axis=1)
        world.action[ids], world.previous[ids] = action, previous
        self._line.asked[ids] = asked.reshape(len(ids), -1, j)
        world.set_clock(ids, clock)
        self.fell[ids] = fell[:, 0] > 0


def _xml(body: LeggedBody, contact: Contact) -> str:
    spec = body.spec.copy()
    add_scene(spec, "ground", contact)
    spec.compile()
    return spec.to_xml()


def _tilted(up: NDArray[np.float32], tilt: Array) -> Array:
    """Up as an IMU tells it that is turned by small angles about its x and y axis; both shape (n, ...)."""
    wrong = up.astype(np.float64) + np.cross(up, np.column_stack([tilt, np.zeros(len(tilt))]))
    return wrong / np.linalg.norm(wrong, axis=1, keepdims=True)
