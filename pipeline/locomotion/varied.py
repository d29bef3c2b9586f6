"""VariedWorld: legged robots that differ from each other: what training randomizes, so that no robot comes unawares."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import override

import numpy as np
from numpy.typing import NDArray

from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.delay import DelayLine
from pipeline.locomotion.spaces import SENSED_MOST
from pipeline.locomotion.starts import Start
from pipeline.locomotion.tasks import LeggedTask
from pipeline.locomotion.world import SPEED_SCALE, TURN_SCALE, LeggedWorld
from pipeline.protocols import Array, Ids
from schemas.scene import Draw

RANGES: MappingProxyType[str, tuple[str, float, float, float]] = MappingProxyType({
    "payload": ("1", 0.0, 0.0, 0.1), "payload_x": ("m", 0.0, -0.04, 0.04), "payload_z": ("m", 0.0, 0.0, 0.25),
    "strength": ("1", 1.0, 0.85, 1.05), "stiffness": ("1", 1.0, 0.9, 1.05), "damping": ("1", 1.0, 0.8, 1.4),
    "ground": ("1", 1.0, 0.5, 1.0), "delay_s": ("s", 0.0, 0.0, 0.005), "noise": ("1", 0.0, 0.0, 1.0),
    "skew": ("1", 0.0, 0.0, 1.0)})
"""What differs -> unit, nominal value, and the range that training draws from evenly.

payload is a load on the base as a share of the robot's mass, at x and z from the base's origin; strength, stiffness and
damping are relative to the data sheet; ground is sliding friction; noise and skew are shares of SENSORS' values.
"""
SENSORS = MappingProxyType({"turning": (0.03, 0.02), "tilt": (0.006, 0.01), "joints": (0.0015, 0.008),
                            "rates": (0.06, 0.0)})
"""Sensor -> standard deviation each tick, and of what stays the same for a robot [rad/s, rad, rad, rad/s]."""


def vary(rng: np.random.Generator, widen: float = 1.0) -> tuple[Draw, ...]:
    """Draw everything that differs once, in the table's order; `widen` scales the distance from the nominal value."""
    return tuple(Draw(name=name, unit=unit, value=float(nominal + widen * (rng.uniform(low, high) - nominal)))
                 for name, (unit, nominal, low, high) in RANGES.items())


class VariedWorld(LeggedWorld):
    """As LeggedWorld, each place with a robot of its own, which it keeps for good.

    Args:
        body, task: what is done.
        draws: of each place, see `vary`; what is not drawn is nominal.
        seed: of the noise of the sensors.
        threads: threads of the engine; results do not depend on them.
    """

    def __init__(self, body: LeggedBody, task: LeggedTask, draws: Sequence[Sequence[Draw]], *, seed: int,
                 threads: int = 1) -> None:
        super().__init__(body, task, len(draws), threads=threads)
        self._differs = {name: np.full(self.n, nominal) for name, (_, nominal, _, _) in RANGES.items()}
        for place, drawn in enumerate(draws):
            for draw in drawn:
                self._differs[draw.name][place] = draw.value
        joints, self._seed, self._acted = len(body.joints), seed, 0
        delay = np.round(self._differs["delay_s"] * task.control_hz * task.substeps).astype(np.int64)
        self._places, self._line = np.arange(self.n), DelayLine(delay, task.substeps, joints)
        skew = np.random.default_rng([seed, 83]).standard_normal((self.n, 5 + joints)) * self._differs["skew"][:, None]
        self._skew = skew * np.repeat([SENSORS[k][1] for k in ("turning", "tilt", "joints")], [3, 2, joints])
        self._apply()

    def _apply(self) -> None:
        """Write what differs into the model of every place."""
        d, model, batch = self._differs, self.model, self.batch
        names = ("body_mass", "body_inertia", "body_ipos", "actuator_gainprm", "actuator_biasprm",
                 "actuator_forcerange", "dof_damping", "geom_friction")
        field: dict[str, Array] = {name: batch.expand(name) for name in names}
        root = model.body(self.body.root).id
        before, load = float(model.body_mass[root]), d["payload"] * float(model.body_mass.sum())
        share = load / (before + load)
        field["body_mass"][:, root] = before + load
        field["body_inertia"][:, root] *= (1 + load / before)[:, None]
        for axis, name in ((0, "payload_x"), (2, "payload_z")):
            field["body_ipos"][:, root, axis] += share * (d[name] - float(model.body_ipos[root, axis]))
        if self.body.control == "position":
            field["actuator_gainprm"][:, :, 0] *= d["stiffness"][:, None]
            field["actuator_biasprm"][:, :, 1:3] *= d["stiffness"][:, None, None]
            field["actuator_forcerange"][:] *= d["strength"][:, None, None]
        else:
            field["actuator_gainprm"][:, :, 0] *= d["strength"][:, None]
        field["dof_damping"][:, self._v] *= d["damping"][:, None]
        field["geom_friction"][:, np.flatnonzero(model.geom_contype | model.geom_conaffinity), 0] = d["ground"][:, None]
        batch.set_const()

    @override
    def act(self, action: Array) -> None:
        """As LeggedWorld.act; what the motors hear is as late as each robot's delay."""
        self._accept(action)
        self._line.ask(self.action, self._places)
        for action, steps in self._line.heard(self._places):
            self._ctrl[:] = self.targets(action)
            self.batch.step(nstep=steps)
        self.ticks += 1
        self._acted += 1

    @override
    def restart(self, ids: Ids, starts: Sequence[Start]) -> None:
        """As LeggedWorld.restart; nothing is on its way to the motors."""
        super().restart(ids, starts)
        self._line.asked[ids] = 0.0

    @override
    def observe(self) -> NDArray[np.float32]:
        """As LeggedWorld.observe, with the faults of each robot's sensors."""
        sensed, joints = super().observe(), len(self.body.joints)
        noise = np.random.default_rng([self._seed, self._acted, 89]).standard_normal((self.n, 5 + 2 * joints))
        noise *= self._differs["noise"][:, None] * np.repeat(
            [SENSORS[k][0] for k in ("turning", "tilt", "joints", "rates")], [3, 2, joints, joints])
        noise[:, :5 + joints] += self._skew
        sensed[:, :3] += TURN_SCALE * noise[:, :3]
        sensed[:, 3:5] += noise[:, 3:5]
        sensed[:, 6:6 + joints] += noise[:, 5:5 + joints]
        sensed[:, 6 + joints:6 + 2 * joints] += SPEED_SCALE * noise[:, 5 + joints:]
        return np.clip(sensed, -SENSED_MOST, SENSED_MOST, out=sensed)

    @override
    def save(self) -> Mapping[str, NDArray[np.float64]]:
        """As LeggedWorld.save, and what is on its way to the motors."""
        return {**super().save(), "line": self._line.asked.copy(), "acted": np.array([float(self._acted)])}

    @override
    def load(self, saved: Mapping[str, NDArray[np.float64]]) -> None:
        """Go on from what `save` gave, bit for bit."""
        super().load(saved)
        self._line.asked[:], self._acted = saved["line"], int(saved["acted"][0])
