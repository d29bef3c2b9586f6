"""LeggedWorld: n legged robots side by side in one Batch, pushed, judged and rewarded at their control rate."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from pipeline.errors import SimulationError
from pipeline.locomotion.body import SENSED_BY_FEET, LeggedBody, let_feet_meet
from pipeline.locomotion.rewards import REWARDS, Motion
from pipeline.locomotion.spaces import SENSED_MOST
from pipeline.locomotion.starts import Start
from pipeline.locomotion.tasks import LeggedTask
from pipeline.protocols import Array, Ids
from pipeline.simulation.scenes import NOMINAL, Contact, add_scene

SPEED_SCALE, TURN_SCALE = 0.1, 0.25
"""What joint speeds [rad/s] and turning speeds [rad/s] are multiplied by in an observation, so that all is near 1."""
PRESSES_N = 1.0
"""Force from which on a foot counts as standing [N]."""


def width_of(body: LeggedBody, task: LeggedTask) -> int:
    """How many values a robot senses."""
    return 9 + 3 * len(body.joints) + 2 * bool(task.stride_s)


def compiled(body: LeggedBody, task: LeggedTask, scene: str = "ground", contact: Contact = NOMINAL) -> mujoco.MjModel:
    """The robot in its scene, at the time step that the task asks for."""
    spec = body.spec.copy()
    step_s = 1 / task.control_hz / task.substeps
    if task.solid_feet:
        let_feet_meet(spec, body.feet)
    add_scene(spec, scene, contact.model_copy(update={"timestep_s": step_s}))
    return spec.compile()


class LeggedWorld:
    """n robots on one control clock.

    Args:
        body: the robot, of which every attempt has one.
        task: what they are to do.
        n: how many.
        threads: threads of the engine; results do not depend on them.
        scene: key of SCENES.
    """

    def __init__(self, body: LeggedBody, task: LeggedTask, n: int, *, threads: int = 1, scene: str = "ground",
                 contact: Contact = NOMINAL) -> None:
        self.body, self.task, self.n = body, task, n
        self.model = compiled(body, task, scene, contact)
        self.batch = Batch(self.model, nsim=n, nthread=threads, persistent=True)
        self._qpos, self._qvel, self._ctrl = (self.batch.bind(k) for k in ("qpos", "qvel", "ctrl"))
        self._force, self._touch = self.batch.bind("qfrc_actuator"), self.batch.bind("sensordata")
        model = self.model
        self._q = np.array([model.joint(j).qposadr[0] for j in body.joints])
        self._v = np.array([model.joint(j).dofadr[0] for j in body.joints])
        self._in_order = bool((self._q == np.arange(7, 7 + len(self._q))).all() and model.nq == 7 + len(self._q))
        self._feet = np.array([model.sensor(f + SENSED_BY_FEET).adr[0] for f in body.feet])
        self._home, self._limit = np.array(body.home), limits(model)
        self._rest = np.zeros(len(body.joints)) if body.rest is None else np.array(body.rest)
        self._low, self._high = model.jnt_range[[model.joint(j).id for j in body.joints]].T
        joints = len(body.joints)
        self.action, self.previous = np.zeros((n, joints)), np.zeros((n, joints))
        self.command = np.zeros((n, 3))
        self.ticks = np.zeros(n, np.int64)
        self._blows: NDArray[np.float64] = np.zeros((n, 0, 3))
        self._next_blow = np.zeros(n, np.int64)

    @property
    def action_size(self) -> int:
        """How many joints are commanded."""
        return len(self.body.joints)

    @property
    def width(self) -> int:
        """How many values an observation has."""
        return width_of(self.body, self.task)

    def restart(self, ids: Ids, starts: Sequence[Start]) -> None:
        """Begin other attempts in the places `ids`; the others go on undisturbed."""
        home = self._home
        self.batch.reset(ids, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        joints = np.clip(home + np.stack([s.bend for s in starts]), self._low, self._high)
        self._qpos[ids[:, None], self._q] = joints
        self._qpos[ids, 3:7] = np.stack([s.quaternion for s in starts])
        self._qvel[ids, :6] = np.stack([s.velocity for s in starts])
        self._qpos[ids, 2] = [s.height_m for s in starts]
        self._ctrl[ids] = home if self.body.control == "position" else self._rest
        self.action[ids] = self.previous[ids] = 0.0
        self.command[ids] = [s.command for s in starts]
        self.ticks[ids] = 0
        longest = max(len(s.blows) for s in starts)
        if longest > self._blows.shape[1]:
            self._blows = np.concatenate(
                [self._blows, np.full((self.n, longest - self._blows.shape[1], 3), np.inf)], axis=1)
        self._blows[ids] = np.inf
        for i, start in zip(ids, starts, strict=True):
            self._blows[i, :len(start.blows)] = start.blows
            if start.rates is not None:
                self._qvel[i, self._v] = start.rates
        self._next_blow[ids] = 0

    def act(self, action: Array) -> None:
        """Send every robot its action, shares in [-1, 1] of shape (n, joints), and let one control period pass.

        Raises:
            SimulationError: another shape, or a value that is not finite.
        """
        self._accept(action)
        self._ctrl[:] = self.targets(self.action)
        self.batch.step(nstep=self.task.substeps)
        self.ticks += 1

    def _accept(self, action: Array) -> None:
        """Look at what was asked for, remember it, and let the blows come that are due."""
        if action.shape != self.action.shape:
            raise SimulationError(f"action of shape {action.shape}, the robots take {self.action.shape}", where="step",
                                  mend=f"send one share in [-1, 1] for each of {', '.join(self.body.joints)}")
        if not np.isfinite(action).all():
            raise SimulationError("action holds a value that is not finite", where="step",
                                  mend="look at the policy: its weights or its input hold NaN or infinity")
        self.previous, self.action = self.action, np.clip(action, -1.0, 1.0)
        self._push()

    def act_on(self, ids: Ids, action: Array, sent: Sequence[tuple[Array, int]]) -> None:
        """As `act` for some attempts, whose motors may hear of their actions late; the others stand still.

        Args:
            ids: attempts, k of them.
            action: shares in [-1, 1], shape (k, joints): what they are seen to have asked for.
            sent: what the motors are told, as `targets` gives it, shape (k, joints), and for how many steps of the
                engine, one after the other; `substeps` in all.
        """
        self.previous[ids], self.action[ids] = self.action[ids], action
        self._push(ids)
        for targets, steps in sent:
            self._ctrl[ids] = targets
            self.batch.step(ids, nstep=steps)
        self.ticks[ids] += 1

    def targets(self, action: Array) -> Array:
        """What the motors are told where shares are asked for: angles [rad], or torques [N m]."""
        if self.body.control == "position":
            return self._home + self.body.scale * action
        return self._rest + self._limit * self.body.scale * action

    def _push(self, ids: Ids | None = None) -> None:
        """Blows whose tick has come change the speed of the base over ground."""
        if not self._blows.shape[1]:
            return
        which = np.minimum(self._next_blow, self._blows.shape[1] - 1)
        blow = self._blows[np.arange(self.n), which]
        due = np.flatnonzero((blow[:, 0] <= self.ticks) & (self._next_blow < self._blows.shape[1]))
        if ids is not None:
            due = np.intersect1d(due, ids)
        if len(due):
            self._qvel[due, :2] += blow[due, 1:]
            self._next_blow[due] += 1

    def observe(self) -> NDArray[np.float32]:
        """What the robots sense, shape (n, w): turning speed, up, joints, joint speeds, last action, command, clock."""
        q, v = self._joints()
        parts = [self._qvel[:, 3:6] * TURN_SCALE, up_of(self._qpos[:, 3:7]), q - self._home, v * SPEED_SCALE,
                 self.action, self.command]
        if self.task.stride_s:
            angle = 2 * np.pi * self.phase()[:, None]
            parts += [np.sin(angle), np.cos(angle)]
        sensed = np.concatenate(parts, axis=1, dtype=np.float32, casting="same_kind")
        return np.clip(sensed, -SENSED_MOST, SENSED_MOST, out=sensed)

    def _joints(self) -> tuple[Array, Array]:
        if self._in_order:
            return self._qpos[:, 7:], self._qvel[:, 6:]
        return self._qpos[:, self._q], self._qvel[:, self._v]

    def _efforts(self) -> Array:
        force = self._force[:, 6:] if self._in_order else self._force[:, self._v]
        return force / self._limit

    def rates(self, ids: Ids) -> Array:
        """Speeds of the joints, true [rad/s], shape (len(ids), joints)."""
        return self._qvel[np.ix_(ids, self._v)]

    def clock(self, ids: Ids) -> Array:
        """Ticks so far and blows so far, shape (len(ids), 2)."""
        return np.column_stack([self.ticks[ids], self._next_blow[ids]]).astype(np.float64)

    def set_clock(self, ids: Ids, clock: Array) -> None:
        """Go on from what `clock` gave."""
        self.ticks[ids], self._next_blow[ids] = clock.astype(np.int64).T

    def position(self) -> Array:
        """Where the bases are, true [m], shape (n, 3)."""
        return self._qpos[:, :3].copy()

    def orientation(self) -> Array:
        """How the bases are turned, true, quaternions w, x, y, z, shape (n, 4)."""
        return self._qpos[:, 3:7].copy()

    def as_starts(self, ids: Ids) -> list[Start]:
        """Where robots are now, true, as starts of other attempts; without what will push them."""
        joints, rates = self._joints()
        bend = joints - self._home
        return [Start(float(self._qpos[i, 2]), self._qpos[i, 3:7].copy(), self._qvel[i, :6].copy(), bend[i].copy(),
                      self.command[i].copy(), np.zeros((0, 3)), rates[i].copy()) for i in ids]

    @staticmethod
    def command_at(joints: int) -> slice:
        """Where the command stands in an observation of a robot with so many joints."""
        return slice(6 + 3 * joints, 9 + 3 * joints)

    def phase(self) -> Array:
        """The gait's clock, in [0, 1), shape (n,)."""
        period = self.task.stride_s * self.task.control_hz
        return np.asarray((self.ticks % period) / period if period else np.zeros(self.n), np.float64)

    def motion(self) -> Motion:
        """What truly happens at this tick."""
        quaternion = self._qpos[:, 3:7]
        forward = heading_of(quaternion)
        over = self._qvel[:, :2]
        along = (over * forward).sum(axis=1)
        left = forward[:, 0] * over[:, 1] - forward[:, 1] * over[:, 0]
        return Motion(up=up_of(quaternion), height=self._qpos[:, 2] / self.body.height_m,
                      velocity=np.column_stack([along, left, self._qvel[:, 5]]), command=self.command,
                      joints=self._joints()[0] - self._home, effort=self._efforts(), action=self.action,
                      previous=self.previous, contact=self._touch[:, self._feet] > PRESSES_N, phase=self.phase())

    def rewards(self, now: Motion) -> Mapping[str, Array]:
        """Reward term -> its weighted value of this tick, shape (n,)."""
        return {name: weight * REWARDS[name](now) for name, weight in self.task.weights.items()}

    def fallen(self, now: Motion) -> NDArray[np.bool_]:
        """Which robots have fallen, shape (n,): they lean too far, or their base is too low."""
        stands = (now.up[:, 2] >= np.cos(self.task.fallen_rad)) & (now.height >= self.task.fallen_height)
        return ~stands  # so that a robot whose physics diverged has fallen, too

    def save(self) -> Mapping[str, NDArray[np.float64]]:
        """All that a restart from this very moment needs."""
        return {"state": self.batch.state.copy(), "action": self.action.copy(), "previous": self.previous.copy(),
                "command": self.command.copy(), "ticks": self.ticks.astype(np.float64), "blows": self._blows.copy(),
                "next_blow": self._next_blow.astype(np.float64)}

    def load(self, saved: Mapping[str, NDArray[np.float64]]) -> None:
        """Go on from what `save` gave, bit for bit; SimulationError for another number or kind of robots."""
        if saved["state"].shape != self.batch.state.shape:
            raise SimulationError(f"states of shape {saved['state'].shape}, this world has {self.batch.state.shape}",
                                  where="restore", mend="restore with the body, task and number that were saved")
        self.batch.state[:] = saved["state"]
        self.action, self.previous = saved["action"].copy(), saved["previous"].copy()
        self.command[:] = saved["command"]
        self.ticks[:] = saved["ticks"]
        self._blows, self._next_blow = saved["blows"].copy(), saved["next_blow"].astype(np.int64)


def limits(model: mujoco.MjModel) -> Array:
    """Largest force of each actuator [N m]; 1 where the model names none."""
    force, control = model.actuator_forcerange[:, 1], model.actuator_ctrlrange[:, 1]
    joint = model.jnt_actfrcrange[model.actuator_trnid[:, 0], 1]
    motor = model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE
    limit = np.where(force > 0, force, np.where(motor & (control > 0), control, joint))
    return np.where(limit > 0, limit, 1.0)


def up_of(quaternion: Array) -> Array:
    """The world's up in the frame that a quaternion turns into, (n, 4) -> (n, 3): what an IMU's filter tells."""
    w, x, y, z = quaternion.T
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)


def rotated(quaternion: Sequence[float], vector: Array, *, back: bool = False) -> Array:
    """A vector (3,) turned by a quaternion w, x, y, z, or back."""
    w, (x, y, z) = quaternion[0], (-1 if back else 1) * np.array(quaternion[1:])
    part = 2 * np.cross([x, y, z], vector)
    return np.asarray(vector + w * part + np.cross([x, y, z], part), np.float64)


def heading_of(quaternion: Array) -> Array:
    """Where the base's x axis points over ground, unit vectors, (n, 4) -> (n, 2)."""
    w, x, y, z = quaternion.T
    forward = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)], axis=1)
    return forward / np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-9)
