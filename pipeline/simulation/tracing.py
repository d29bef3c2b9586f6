"""Tracer: keeps, tick by tick, everything of n attempts that a recording holds."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from typing import Any, Protocol

import mujoco
import numpy as np

from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.trace import Event, Shadow, Trace


class Modelled(Protocol):
    """A compiled robot and scene."""

    @property
    def model(self) -> Any:
        """A mujoco.MjModel."""
        ...


class Traced(Protocol):
    """n simulated robots side by side of which everything is known: a World, or LeggedRobots."""

    n: int
    control_hz: float
    batch: Any
    efforts: Any

    @property
    def setup(self) -> Modelled:
        """What is simulated."""
        ...

    def save(self, ids: Ids) -> tuple[Array, Array]:
        """State rows: the engine's and the controller's."""
        ...

    def speeds(self, ids: Ids) -> Array:
        """Joint speeds, shape (len(ids), j)."""
        ...

    def sent(self, ids: Ids) -> Array:
        """What the joints were sent last, shape (len(ids), j)."""
        ...

    def rewards(self, ids: Ids) -> dict[str, Array]:
        """Reward terms of the tick just passed, each (len(ids),)."""
        ...


class Tracer:
    """Collects rows for the attempts that act, and hands out one Trace an attempt.

    Args:
        world: the attempts; its engine computes body poses once a tick more.
        joints: names of the joints, of a robot that is not the reference arm.
        torque: whether what those are sent are torques.
    """

    def __init__(self, world: Traced, *, joints: tuple[str, ...] = (), torque: bool = False) -> None:
        self._joints, self._torque = joints, torque
        self._world, model = world, world.setup.model
        self._bodies = np.array([i for i in range(1, model.nbody) if model.body(i).name != "target"])
        self.links = tuple(model.body(i).name for i in self._bodies)
        self._xpos, self._xquat = world.batch.bind("xpos"), world.batch.bind("xquat")
        self._rows: list[dict[str, Array]] = []
        self._ids: list[Ids] = []
        self._pending: dict[str, Array] = {}
        self._efforts = np.zeros((world.n, model.nu))
        self.events: list[list[Event]] = [[] for _ in range(world.n)]
        self.phases: list[dict[int, str]] = [{} for _ in range(world.n)]

    def before(self, ids: Ids, observation: Observation, action: Array, policy: Policy) -> None:
        """Keep what is known before the action of this tick is sent."""
        world = self._world
        sim, controller = world.save(ids)
        world.batch.forward(ids, stage=int(mujoco.mjtStage.mjSTAGE_POS))
        poses = np.concatenate([self._xpos[np.ix_(ids, self._bodies)], self._xquat[np.ix_(ids, self._bodies)]], axis=2)
        self._ids.append(ids)
        self._rows.append({
            "state": observation.state, "environment": observation.environment, "action": action,
            "joint_velocity": world.speeds(ids), "joint_effort": self._efforts[ids], "link_poses": poses,
            "sim_state": sim, "controller": np.concatenate([controller, policy.memory(ids)], axis=1),
            **self._pending})
        self._pending = {}

    def after(self, ids: Ids) -> None:
        """Keep what the action of this tick led to."""
        world, row = self._world, self._rows[-1]
        self._efforts[ids] = world.efforts[ids]
        row["joint_action"] = world.sent(ids)
        for name, value in world.rewards(ids).items():
            row[f"reward/{name}"] = value

    def pend(self, name: str, values: Array) -> None:
        """Keep one more column for the attempts of the tick whose `before` comes next, shape (len(ids), ...)."""
        self._pending[name] = values

    def newest(self) -> dict[str, Array]:
        """The columns of the tick that was kept last, each (len(ids), ...), for who records while it happens."""
        return self._rows[-1]

    def traces(self) -> list[Trace]:
        """One Trace an attempt, in the order of the world's attempts."""
        order = np.concatenate(self._ids)
        by_attempt = np.argsort(order, kind="stable")
        counts = np.bincount(order, minlength=self._world.n)
        cuts = np.cumsum(counts)[:-1]
        names = self._rows[0].keys()
        tables = {n: np.split(np.concatenate([r[n] for r in self._rows])[by_attempt], cuts) for n in names}
        return [self._trace(i, {n: t[i] for n, t in tables.items()}) for i in range(self._world.n)]

    def _trace(self, attempt: int, table: dict[str, Array]) -> Trace:
        rewards = {n.removeprefix("reward/"): table.pop(n) for n in list(table) if n.startswith("reward/")}
        signals = {n.removeprefix("signal/"): table.pop(n) for n in list(table) if n.startswith("signal/")}
        shadows = {n.split("/")[1]: Shadow(table[n], table.pop(n.replace("/joint", "/disagreement")))
                   for n in list(table) if n.startswith("shadow/") and n.endswith("/joint")}
        for name in shadows:
            del table[f"shadow/{name}/joint"]
        phase, named = "", list[str]()
        for tick in range(len(table["state"])):
            phase = self.phases[attempt].get(tick, phase)
            named.append(phase)
        return Trace(hz=self._world.control_hz, links=self.links, phase=tuple(named), reward=rewards,
                     shadows=shadows, events=tuple(self.events[attempt]), signals=signals, joints=self._joints,
                     torque=self._torque, **table)
