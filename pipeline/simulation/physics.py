"""Physics that differs from attempt to attempt, and the named randomizations that draw it in training."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType

import mujoco
import numpy as np
from mujoco.batch import Batch

from pipeline.protocols import Array, Ids
from schemas.scene import Draw

MAX_DELAY = 5
"""Longest command delay that the delay line holds, jitter included [ticks]."""

STRIBECK_RAD_S = 0.05
"""Speed at which static friction has fallen to 1/e (Armstrong-Helouvry 1991, Gaussian Stribeck curve)."""


@dataclass(frozen=True, slots=True)
class Physics:
    """One value an attempt, every array of shape (n,); factors are relative to the nominal body."""

    kp: Array
    """Servo stiffness [1]."""
    damping: Array
    """Joint damping [1]."""
    frictionloss: Array
    """Dry friction of the joints [1]."""
    delay: Array
    """Command delay [ticks of the control clock]."""
    backlash: Array
    """Play between motor and joint [rad]."""
    friction: Array
    """Sliding friction of the object [1]."""
    mass: Array
    """Mass of the object [kg]."""
    tilt_x: Array
    """Gravity along x [g]."""
    tilt_y: Array
    """Gravity along y [g]."""
    bias_x: Array
    """Error of the perceived object position [m]."""
    bias_y: Array
    """Error of the perceived object position [m]."""
    noise: Array
    """Standard deviation of the perceived position, each tick [m]."""
    jitter: Array
    """Probability that a command comes one tick later still [1]; zero in training."""
    stiction: Array
    """Additional dry friction at rest, relative to the nominal one [1]; zero in training."""

    def take(self, rows: object) -> "Physics":
        """The same values for a subset of attempts."""
        return Physics(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def put(self, rows: object, other: "Physics") -> None:
        """Overwrite a subset of attempts with the rows of `other`."""
        for f in fields(self):
            getattr(self, f.name)[rows] = getattr(other, f.name)


UNITS = MappingProxyType({
    "kp": "1", "damping": "1", "frictionloss": "1", "delay": "tick", "backlash": "rad", "friction": "1", "mass": "kg",
    "tilt_x": "g", "tilt_y": "g", "bias_x": "m", "bias_y": "m", "noise": "m", "jitter": "1", "stiction": "1",
})
NOMINAL = MappingProxyType({
    "kp": 1.0, "damping": 1.0, "frictionloss": 1.0, "delay": 0.0, "backlash": 0.0, "friction": 1.0, "mass": 0.05,
    "tilt_x": 0.0, "tilt_y": 0.0, "bias_x": 0.0, "bias_y": 0.0, "noise": 0.0, "jitter": 0.0, "stiction": 0.0,
})

LOOK = "look_"
"""How the names of draws begin that only change what is seen, see pipeline.simulation.appearance."""


def from_draws(draws: Sequence[Sequence[Draw]]) -> Physics:
    """Physics of n attempts from their draws; what is not drawn stays nominal, draws of a look are no physics."""
    table = {name: np.full(len(draws), value) for name, value in NOMINAL.items()}
    for row, drawn in enumerate(draws):
        for draw in drawn:
            if not draw.name.startswith(LOOK):
                table[draw.name][row] = draw.value
    return Physics(**table)


type Randomize = Callable[[np.random.Generator, float], float]
"""(generator, factor on the range's width) -> value."""


def _uniform(low: float, high: float, floor: float) -> Randomize:
    middle, half = (low + high) / 2, (high - low) / 2

    def draw(rng: np.random.Generator, widen: float) -> float:
        return max(floor, float(middle + half * widen * rng.uniform(-1, 1)))

    return draw


def _normal(sd: float) -> Randomize:
    return lambda rng, widen: float(rng.normal(0, sd * widen))


def _ticks(high: int) -> Randomize:
    return lambda rng, widen: float(min(MAX_DELAY - 1, rng.integers(0, round(high * widen) + 1)))


RANDOMIZATIONS: MappingProxyType[str, Randomize] = MappingProxyType({
    "kp": _uniform(0.6, 1.3, 0.1),
    "damping": _uniform(0.7, 1.5, 0.1),
    "frictionloss": _uniform(0.5, 2.5, 0.0),
    "delay": _ticks(2),
    "backlash": _uniform(0.0, 0.010, 0.0),
    "friction": _uniform(0.5, 1.2, 0.05),
    "mass": _uniform(0.03, 0.13, 0.005),
    "tilt_x": _normal(0.01),
    "tilt_y": _normal(0.01),
    "bias_x": _normal(0.005),
    "bias_y": _normal(0.005),
    "noise": _uniform(0.0, 0.002, 0.0),
})
"""Parameter of Physics -> how training draws it.

Add one: a field of Physics with unit and nominal value, an entry here."""


def randomize(rng: np.random.Generator, widen: float = 1.0) -> tuple[Draw, ...]:
    """Draw every randomization once, in the table's order."""
    return tuple(Draw(name=name, unit=UNITS[name], value=draw(rng, widen)) for name, draw in RANDOMIZATIONS.items())


class Applied:
    """Physics written into the model fields of a Batch, row by row.

    Args:
        batch: the simulations.
        model: their common model, whose values are the nominal ones.
        dofs: degrees of freedom of the robot's joints.
    """

    def __init__(self, batch: Batch, model: mujoco.MjModel, dofs: Ids) -> None:
        self._batch, self._model, self._dofs = batch, model, dofs
        names = ("actuator_gainprm", "actuator_biasprm", "dof_damping", "dof_frictionloss", "geom_friction",
                 "body_mass", "body_inertia", "geom_size", "geom_rbound", "geom_aabb", "opt.gravity")
        self._fields: dict[str, Array] = {name: batch.expand(name) for name in names}
        self._base = np.zeros((batch.nsim, len(dofs)))
        self._stiction = np.zeros((batch.nsim, len(dofs)))
        self.sticks = False

    def write(self, ids: Ids, physics: Physics, half_m: Array) -> None:
        """Give the simulations `ids` these physics.

        Args:
            ids: simulations, k of them.
            physics: k rows.
            half_m: half edge of each one's cube [m], shape (k,).
        """
        model, fields, dofs, row = self._model, self._fields, self._dofs, ids[:, None]
        arm = np.arange(len(dofs))
        fields["actuator_gainprm"][row, arm, 0] = model.actuator_gainprm[arm, 0] * physics.kp[:, None]
        fields["actuator_biasprm"][row, arm, 1] = model.actuator_biasprm[arm, 1] * physics.kp[:, None]
        fields["dof_damping"][row, dofs] = model.dof_damping[dofs] * physics.damping[:, None]
        self._base[ids] = model.dof_frictionloss[dofs] * physics.frictionloss[:, None]
        fields["dof_frictionloss"][row, dofs] = self._base[ids]
        self._stiction[ids] = physics.stiction[:, None] * model.dof_frictionloss[dofs]
        self.sticks = bool(self._stiction.any())
        body, geom = model.body("object").id, model.geom("object").id
        for name in ("object", "table", "left_pad", "right_pad"):
            # MuJoCo takes the larger friction of a pair: all of them get the drawn value.
            fields["geom_friction"][ids, model.geom(name).id, 0] = physics.friction
        fields["body_mass"][ids, body] = physics.mass
        fields["body_inertia"][ids, body] = (physics.mass * (2 * half_m) ** 2 / 6)[:, None]
        fields["geom_size"][ids, geom] = half_m[:, None]
        fields["geom_rbound"][ids, geom] = half_m * np.sqrt(3)
        fields["geom_aabb"][ids, geom, 3:] = half_m[:, None]
        fields["opt.gravity"][ids, 0] = 9.81 * physics.tilt_x
        fields["opt.gravity"][ids, 1] = 9.81 * physics.tilt_y
        self._batch.set_const(ids)

    def stick(self, velocity: Array, ids: Ids) -> None:
        """Raise dry friction at rest: base + stiction exp(-(v / v_s)^2); velocity [rad/s], shape (len(ids), nq)."""
        extra = self._stiction[ids] * np.exp(-((velocity / STRIBECK_RAD_S) ** 2))
        self._fields["dof_frictionloss"][ids[:, None], self._dofs] = self._base[ids] + extra
