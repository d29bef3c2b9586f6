"""A simulated robot that is driven in time: one attempt of a World, the twin's as well."""

# mujoco is a compiled package without type stubs: a compiled model has no type that a checker knows
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.protocols import Array, Ids, Observation, Signals
from pipeline.recording.live_rows import Row, TickLayout
from pipeline.robots.judging import Judge
from pipeline.robots.limits import Limits
from pipeline.robots.pace import Pace
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.urdf import robot_urdf
from pipeline.simulation.world import LIMITS, OPEN_M, World
from schemas.scene import SceneSpec

ARM = Signals(STATE, ENVIRONMENT, ACTION)
"""Columns of the reference arm."""
ARM_LIMITS = Limits(low=np.array([*-LIMITS, 0.0]), high=np.array([*LIMITS, OPEN_M]), step=np.full(5, np.inf))
"""The largest step of the commanded pose a tick, and what the fingers can do."""
_ONE = np.arange(1)


class SimulatedRobot:
    """Implements pipeline.protocols.LiveRobot with a World of one attempt.

    A person needs longer than the task's own time: the attempt's clock begins again whenever it has run out, and
    perception noise and jitter with it.

    Args:
        world: of one attempt; who made it decides whose physics it has.
        name: what it is called: arm, or twin-SEED.
        judged: by the simulator's truth, or by what the robot perceives, as a twin is.
        speed: simulated seconds a wall second; 0 does not wait.
    """

    signals = ARM

    def __init__(self, world: World, name: str, *, judged: bool, speed: float = 1.0) -> None:
        if world.n != 1:
            raise ConfigError(f"a world of {world.n} attempts", where=f"robot {name}", mend="give a world of one")
        self.world, self.name, self.control_hz = world, name, world.control_hz
        self.judge: Literal["simulator", "sensors"] = "simulator" if judged else "sensors"
        self._judge, self._pace, self._tracer = Judge(world.task), Pace(world.control_hz, speed=speed), Tracer(world)
        self._seen, self._before = world.observe(_ONE), world.commanded(_ONE)

    def connect(self) -> None:
        """Nothing to connect."""

    def disconnect(self) -> None:
        """Nothing to let go."""

    def begin(self, scene: SceneSpec) -> None:
        """Put robot and object at the scene's start."""
        self.world.restart(_ONE, [scene], self.world.physics)
        self._tracer = Tracer(self.world)
        self._judge.reset()
        self._pace.restart()

    def observe(self, ids: Ids) -> Observation:
        """What the robot perceives now."""
        if self.world.command.ticks[0] >= self.world.task.ticks:
            self.world.restart_clock(_ONE)
        self._seen = self.world.observe(ids)
        self._judge.see(self._seen)
        return self._seen

    def act(self, action: Array, ids: Ids) -> None:
        """Send the action that follows what was observed last, and let one control period pass."""
        self._tracer.before(ids, self._seen, action, _NoMemory())
        self._before = self.world.commanded(ids)
        self.world.act(action, ids)
        self._tracer.after(ids)
        self._pace.wait()

    def would_have_sent(self, action: Array) -> Array:
        """Joint targets [rad] and opening [m] of actions (1, 5) in place of the last one, shape (1, 7)."""
        return self.world.would_send(action, _ONE, self._before)

    def succeeded(self) -> bool:
        """By the simulator's truth, or by what the robot perceives."""
        return bool(self.world.succeeded(_ONE)[0]) if self.judge == "simulator" else self._judge.succeeded()

    def phase(self) -> str:
        """Subtask reached, by what the robot perceives."""
        return self._judge.phase()

    def row(self) -> Row:
        """All that a recording holds of the last tick."""
        table = {name: values[0] for name, values in self._tracer.newest().items()}
        rewards = {n.removeprefix("reward/"): float(table.pop(n)) for n in list(table) if n.startswith("reward/")}
        return Row(links=self._tracer.links, reward=rewards, **table)

    def layout(self) -> TickLayout | None:
        """Recorded as the reference arm."""
        return None

    def pictures(self) -> dict[str, NDArray[np.uint8]]:
        """None: a scene's cameras are rendered beside, see pipeline.simulation.live_cameras."""
        return {}

    def attachments(self) -> dict[str, bytes]:
        """Scene and URDF."""
        setup = self.world.setup
        return {"scene.xml": setup.xml.encode(), "robot.urdf": robot_urdf(setup.model, setup.body.root, "arm").encode()}

    def pose_of(self, joints: Array) -> Array:
        """Tool pose x, y, z [m], yaw [rad] at joints [rad], shapes (1, 4) and (1, 6)."""
        return self.world.kinematics.xyz_yaw(joints)

    @property
    def late(self) -> int:
        """Ticks that came late."""
        return self._pace.late


class _NoMemory:
    """Stands where a tracer asks for a policy's memory: the session adds that of the policy that acts."""

    def reset(self, n: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Nobody acts."""
        return np.zeros((len(ids), len(ACTION)))

    def memory(self, ids: Ids) -> Array:
        """No columns."""
        return np.zeros((len(ids), 0))
