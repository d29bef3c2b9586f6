"""World: n attempts of one task side by side in one Batch, acting and perceiving like robots."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from pipeline.protocols import Array, Ids, Observation
from pipeline.simulation.kinematics import Kinematics
from pipeline.simulation.model import Setup
from pipeline.simulation.physics import MAX_DELAY, Applied, Physics, from_draws
from pipeline.simulation.tasks import load_task
from schemas.scene import SceneSpec

CONTROL_HZ = 20.0
LIMITS = np.array([0.02, 0.02, 0.02, 0.12])
"""Largest step of the commanded pose a tick [m, m, m, rad]."""
REACH = np.array([[-0.10, 0.48], [-0.36, 0.36], [0.008, 0.30], [-2.2, 2.2]])
"""Box of commanded poses: x, y, z [m], yaw [rad]."""
OPEN_M = 0.08
HOME = np.array([0.28, 0.0, 0.18, 0.0])
"""Commanded pose at reset [m, rad]."""
CONTROLLER_WIDTH = 5 + 6 + 7 * (MAX_DELAY + 1) + 7 + 3


@dataclass(slots=True)
class _Command:
    """The lower controller's memory; rows are attempts."""

    pose: Array
    opening: Array
    joints: Array
    line: Array
    play: Array
    ticks: NDArray[np.int64]
    held: NDArray[np.int64]
    step: Array


class World:
    """n robots on one control clock; implements pipeline.protocols.Robot.

    Args:
        setup: compiled robot and scene.
        scenes: start of each attempt; all of one task.
        physics: physics of each attempt.
        threads: threads of the engine.
        control_hz: rate of the control clock [Hz]; policies, tasks and twins are made for the default.
    """

    control_hz = CONTROL_HZ

    def __init__(self, setup: Setup, scenes: Sequence[SceneSpec], physics: Physics, *, threads: int = 2,
                 control_hz: float = CONTROL_HZ) -> None:
        self.control_hz = control_hz
        self.setup, self.scenes, self.n = setup, tuple(scenes), len(scenes)
        self.task, self.physics = load_task(scenes[0].task), from_draws([()] * len(scenes))
        model, body = setup.model, setup.body
        self.batch = Batch(model, nsim=self.n, nthread=threads)
        self.kinematics = Kinematics(setup, self.n, threads)
        joint = {model.joint(i).name: i for i in range(model.njnt)}
        self._arm = np.array([model.jnt_qposadr[joint[name]] for name in body.joints])
        self._dof = np.array([model.jnt_dofadr[joint[name]] for name in body.joints])
        self._finger = np.array([model.jnt_qposadr[joint[name]] for name in body.fingers])
        self._finger_dof = np.array([model.jnt_dofadr[joint[name]] for name in body.fingers])
        self._object = int(model.jnt_qposadr[joint["object"]])
        self._object_dof = int(model.jnt_dofadr[joint["object"]])
        self._half, self._target = np.zeros(self.n), np.zeros((self.n, 3))
        self._applied = Applied(self.batch, model, self._dof)
        self._qpos, self._qvel, self._ctrl = (self.batch.bind(k) for k in ("qpos", "qvel", "ctrl"))
        self._mocap = self.batch.bind("mocap_pos")
        self.efforts = self.batch.bind("actuator_force")
        """Actuator forces of the last substep [N m, N], shape (n, 7); valid until the next call of the engine."""
        self._substeps = round(1 / control_hz / model.opt.timestep)
        self._noise = np.empty((self.n, self.task.ticks + 1, 3))
        self._late = np.empty((self.n, self.task.ticks + 1))
        home = np.array([body.home])
        for _ in range(40):
            home = self.kinematics.towards(home, HOME[None])
        self._home = home[0]
        self._measured = np.full((self.n, len(body.joints)), np.nan)
        self._pose = np.zeros((self.n, 4))
        n, lines = self.n, MAX_DELAY + 1
        self.command = _Command(np.zeros((n, 4)), np.zeros(n), np.zeros((n, 6)), np.zeros((n, lines, 7)),
                                np.zeros((n, 7)), np.zeros(n, int), np.zeros(n, int), np.zeros(n))
        self.restart(np.arange(n), self.scenes, physics)

    def restart(self, ids: Ids, scenes: Sequence[SceneSpec], physics: Physics) -> None:
        """Begin other attempts in the places `ids`, to the bit as a new World would.

        Args:
            ids: places to begin anew, k of them; the others go on undisturbed.
            scenes: k starts, of this world's task.
            physics: k rows.
        """
        k, all_scenes = len(ids), list(self.scenes)
        for i, scene in zip(ids, scenes, strict=True):
            all_scenes[i] = scene
            rng = np.random.default_rng([scene.seed, 7])
            self._noise[i] = rng.standard_normal(self._noise.shape[1:])
            self._late[i] = rng.random(self._late.shape[1])
        self.scenes = tuple(all_scenes)
        self.physics.put(ids, physics)
        self._half[ids] = [s.object_half_m for s in scenes]
        self._target[ids] = [[*s.target_xy_m, 0.0] for s in scenes]
        self._applied.write(ids, physics, self._half[ids])
        self.batch.reset(ids, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._qpos[ids[:, None], self._arm] = self._home
        self._qpos[ids[:, None], self._finger] = OPEN_M / 2
        yaw, at = np.array([s.object_yaw_rad for s in scenes]), self._object
        self._qpos[ids, at:at + 2] = [s.object_xy_m for s in scenes]
        self._qpos[ids, at + 2] = self._half[ids]
        self._qpos[ids, at + 3:at + 7] = np.column_stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)])
        self._mocap[ids, 0] = self._target[ids] + [0, 0, 0.0005]
        full = np.tile([*self._home, OPEN_M / 2], (k, 1))
        self._ctrl[ids] = full
        c = self.command
        c.pose[ids], c.opening[ids], c.joints[ids], c.play[ids] = HOME, OPEN_M, self._home, full
        c.line[ids] = full[:, None]
        c.ticks[ids] = c.held[ids] = 0
        c.step[ids] = 0.0

    # -- perceiving -------------------------------------------------------------------------------------------------

    def observe(self, ids: Ids) -> Observation:
        """What the robots perceive now: encoders, forward kinematics, their own command, and a biased camera."""
        c, q = self.command, self._qpos[np.ix_(ids, self._arm)]
        opening = self._qpos[np.ix_(ids, self._finger)].sum(axis=1)
        state = np.column_stack([q, opening, self._pose_of(q, ids), c.pose[ids], c.opening[ids]])
        noise = self._noise[ids, c.ticks[ids]] * self.physics.noise[ids, None]
        seen = self._qpos[ids, self._object:self._object + 3] + noise
        seen[:, 0] += self.physics.bias_x[ids]
        seen[:, 1] += self.physics.bias_y[ids]
        environment = np.column_stack([seen, self._yaw(ids), self._target[ids]])
        return Observation(state, environment)

    def _pose_of(self, q: Array, ids: Ids) -> Array:
        """Tool pose at the measured joints; what the judge of the last tick worked out is not worked out again."""
        new = (self._measured[ids] != q).any(axis=1)
        if new.any():
            self._pose[ids[new]], self._measured[ids[new]] = self.kinematics.xyz_yaw(q[new]), q[new]
        return self._pose[ids]

    def _yaw(self, ids: Ids) -> Array:
        """Yaw of the cube within a quarter turn, the most that a camera can tell [rad]."""
        w, x, y, z = self._qpos[ids, self._object + 3:self._object + 7].T
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return (yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4

    # -- acting -----------------------------------------------------------------------------------------------------

    def act(self, action: Array, ids: Ids) -> None:
        """Move the commanded pose by `action`, solve for joints, and let one control period pass."""
        c = self.command
        pose, opening, joints = self._solved(action, ids)
        c.step[ids] = ((joints - c.joints[ids]) ** 2).sum(axis=1)
        c.pose[ids], c.opening[ids], c.joints[ids] = pose, opening, joints
        c.line[ids, 1:] = c.line[ids, :-1]
        c.line[ids, 0, :6], c.line[ids, 0, 6] = joints, opening / 2
        late = self._late[ids, c.ticks[ids]] < self.physics.jitter[ids]
        delay = np.minimum(self.physics.delay[ids].astype(int) + late, MAX_DELAY)
        wanted = c.line[ids, delay]
        # Play operator: the joint follows only once the motor has crossed the gap.
        half = self.physics.backlash[ids, None] / 2
        wanted[:, :6] = np.clip(c.play[ids, :6], wanted[:, :6] - half, wanted[:, :6] + half)
        c.play[ids] = wanted
        self._ctrl[ids] = wanted
        if self._applied.sticks:
            self._applied.stick(self._qvel[np.ix_(ids, self._dof)], ids)
        self.batch.step(ids, nstep=self._substeps)
        c.ticks[ids] += 1
        self._judge(ids)

    def _solved(self, action: Array, ids: Ids, since: tuple[Array, Array] | None = None) -> tuple[Array, Array, Array]:
        """Commanded pose, opening and joints that an action asks for."""
        pose, joints = since or self.commanded(ids)
        pose = np.clip(pose + np.clip(action[:, :4], -LIMITS, LIMITS), REACH[:, 0], REACH[:, 1])
        return pose, np.clip(action[:, 4], 0.0, OPEN_M), self.kinematics.towards(joints, pose)

    def commanded(self, ids: Ids) -> tuple[Array, Array]:
        """Pose (len(ids), 4) and joints (len(ids), 6) commanded last, copied."""
        return self.command.pose[ids], self.command.joints[ids]

    def would_send(self, action: Array, ids: Ids, since: tuple[Array, Array] | None = None) -> Array:
        """Joint targets [rad] and opening [m] that an action would send; nothing moves, shape (len(ids), 7).

        Args:
            action: shape (len(ids), 5).
            ids: its attempts.
            since: what `commanded` gave at the moment in question; now where None.
        """
        _, opening, joints = self._solved(action, ids, since)
        return np.column_stack([joints, opening])

    def sent(self, ids: Ids) -> Array:
        """Joint targets last sent [rad] and opening [m], shape (len(ids), 7)."""
        return np.column_stack([self.command.joints[ids], self.command.opening[ids]])

    def speeds(self, ids: Ids) -> Array:
        """Joint speeds [rad/s] and opening speed [m/s], shape (len(ids), 7)."""
        opening = self._qvel[np.ix_(ids, self._finger_dof)].sum(axis=1)
        return np.column_stack([self._qvel[np.ix_(ids, self._dof)], opening])

    def truth(self, ids: Ids) -> Array:
        """Where the cube really is: x, y, z [m], yaw [rad]; for judges and stand-ins for people only."""
        return np.column_stack([self._qpos[ids, self._object:self._object + 3], self._yaw(ids)])

    # -- judging ----------------------------------------------------------------------------------------------------

    def _judge(self, ids: Ids) -> None:
        c, task = self.command, self.task
        q = self._qpos[np.ix_(ids, self._arm)]
        self._tool = self._pose_of(q, ids)[:, :3]
        cube = self._qpos[ids, self._object:self._object + 3]
        opening = self._qpos[np.ix_(ids, self._finger)].sum(axis=1)
        at = np.hypot(*(cube - self._target[ids])[:, :2].T) < task.within_m
        low = np.abs(cube[:, 2] - self._half[ids]) < task.on_table_m
        away = np.linalg.norm(self._tool - cube, axis=1) > task.hand_away_m
        c.held[ids] = np.where(at & low & away & (opening > task.open_m), c.held[ids] + 1, 0)
        self._reward_inputs = (cube, opening)

    def succeeded(self, ids: Ids) -> NDArray[np.bool_]:
        """Truth: on the mark, on the table, let go and away, for the hold time."""
        return self.command.held[ids] >= self.task.hold_ticks

    def rewards(self, ids: Ids) -> dict[str, Array]:
        """Reward terms of the tick just passed for the ids that just acted, weights applied, each (len(ids),)."""
        cube, opening = self._reward_inputs
        reach = np.linalg.norm(self._tool - cube, axis=1)
        gap = np.linalg.norm(cube - self._target[ids] - [0, 0, 1] * self._half[ids, None], axis=1)
        held = (reach < 0.03) & (np.abs(opening - 2 * self._half[ids]) < 0.008)
        terms = {"reach": np.exp(-reach / 0.1), "grasp": held.astype(float), "carry": np.exp(-gap / 0.1),
                 "success": self.succeeded(ids).astype(float), "effort": self.command.step[ids]}
        return {name: weight * terms[name] for name, weight in self.task.weights.items()}

    def restart_clock(self, ids: Ids) -> None:
        """Give attempts that were restored their full time again; noise and jitter start over with it."""
        self.command.ticks[ids] = 0

    # -- restoring --------------------------------------------------------------------------------------------------

    def place_arm(self, ids: Ids, joints: Array, speeds: Array) -> None:
        """Put arms where somebody believes them to be; what the controller remembers stays.

        Args:
            ids: places, k of them.
            joints: joints [rad] and opening [m], shape (k, 7).
            speeds: of the same [rad/s, m/s], shape (k, 7).
        """
        row = ids[:, None]
        self._qpos[row, self._arm], self._qvel[row, self._dof] = joints[:, :6], speeds[:, :6]
        self._qpos[row, self._finger], self._qvel[row, self._finger_dof] = joints[:, 6:] / 2, speeds[:, 6:] / 2

    def place_cube(self, ids: Ids, cube: Array, speed: Array) -> None:
        """Put cubes upright where somebody believes them to be.

        Args:
            ids: places, k of them.
            cube: centre x, y, z [m] and yaw [rad], shape (k, 4).
            speed: along x, y, z [m/s], shape (k, 3).
        """
        at, dof, half, none = self._object, self._object_dof, cube[:, 3] / 2, np.zeros(len(ids))
        self._qpos[ids, at:at + 3], self._qvel[ids, dof:dof + 3] = cube[:, :3], speed
        self._qpos[ids, at + 3:at + 7] = np.column_stack([np.cos(half), none, none, np.sin(half)])
        self._qvel[ids, dof + 3:dof + 6] = 0.0

    def half(self, ids: Ids) -> Array:
        """Half edges of the cubes [m], shape (len(ids),)."""
        return self._half[ids]

    def shift_cube(self, ids: Ids, by: Array) -> None:
        """Move cubes by x, y, z [m], shape (k, 3), as they are turned and however fast they are."""
        self._qpos[ids, self._object:self._object + 3] += by

    def save(self, ids: Ids) -> tuple[Array, Array]:
        """State rows: the engine's (mjSTATE_INTEGRATION) and the controller's, CONTROLLER_WIDTH wide."""
        rows, c = self.batch.state[ids].copy(), self.command
        memory = np.column_stack([c.pose[ids], c.opening[ids], c.joints[ids], c.line[ids].reshape(len(ids), -1),
                                  c.play[ids], c.ticks[ids], c.held[ids], c.step[ids]]).astype(np.float64)
        return rows, memory

    def load(self, ids: Ids, rows: Array, memory: Array) -> None:
        """Restore what `save` gave, bit for bit."""
        self.batch.state[ids] = rows
        c, lines = self.command, 7 * (MAX_DELAY + 1)
        c.pose[ids], c.opening[ids], c.joints[ids] = memory[:, :4], memory[:, 4], memory[:, 5:11]
        c.line[ids] = memory[:, 11:11 + lines].reshape(len(ids), MAX_DELAY + 1, 7)
        c.play[ids] = memory[:, 11 + lines:18 + lines]
        rest = memory[:, 18 + lines:21 + lines]
        c.ticks[ids], c.held[ids] = rest[:, :2].astype(int).T
        c.step[ids] = rest[:, 2]
