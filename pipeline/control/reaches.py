"""Reaches: where a hand is to be, and the physics that it meets on the way, drawn from a seed alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.protocols import Array
from pipeline.simulation.bodies import load_body
from pipeline.simulation.kinematics import Kinematics
from pipeline.simulation.model import compose
from pipeline.simulation.physics import randomize
from schemas.scene import Draw

BOX = np.array([[0.15, 0.48], [-0.36, 0.36], [0.05, 0.30], [-1.2, 1.2]])
"""Goals are drawn in this box: x, y, z [m], yaw [rad]; those out of reach are drawn again."""
REACHED_M = 1e-4
PAYLOAD_KG = 0.5
"""Largest mass in a perturbed hand that its controller does not know of."""
SOLVING = 200
"""Steps of the inverse kinematics that tell whether a goal can be reached."""


@dataclass(frozen=True, slots=True)
class Reach:
    """One attempt."""

    goal: tuple[float, float, float, float]
    """x, y, z [m], yaw [rad]; the hand points down."""
    draws: tuple[Draw, ...] = ()
    """Physics that differs from the nominal one, as training draws it."""
    payload_kg: float = 0.0


def draw_reaches(n: int, seed: int, *, perturbed: bool) -> list[Reach]:
    """n attempts of this seed; the goals are the same with and without perturbed physics."""
    goals = _within_reach(np.random.default_rng([seed, 73]), n)
    made: list[Reach] = []
    for k, goal in enumerate(goals.tolist()):
        rng = np.random.default_rng([seed, k, 79])
        draws = randomize(rng) if perturbed else ()
        made.append(Reach(tuple(goal), draws, float(rng.uniform(0, PAYLOAD_KG)) if perturbed else 0.0))
    return made


def _within_reach(rng: np.random.Generator, n: int) -> Array:
    """Goals that the nominal arm can reach, shape (n, 4)."""
    setup = compose(load_body("arm"), "table")
    kinematics = Kinematics(setup, n, 1)
    low, high = BOX.T
    goals: Array = rng.uniform(low, high, (n, 4))
    while (far := ~_reachable(kinematics, np.array(setup.body.home), goals)).any():
        goals[far] = rng.uniform(low, high, (int(far.sum()), 4))
    return goals


def _reachable(kinematics: Kinematics, home: Array, goals: Array) -> NDArray[np.bool_]:
    q = np.repeat(home[None], len(goals), axis=0)
    for _ in range(SOLVING):
        q = kinematics.towards(q, goals)
    at = kinematics.xyz_yaw(q)
    return (np.linalg.norm(at[:, :3] - goals[:, :3], axis=1) < REACHED_M) & (np.abs(at[:, 3] - goals[:, 3]) < 0.01)
