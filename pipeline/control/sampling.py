"""Predictive sampling: plans for n robots, each bettered by trying others near it in simulation."""

from typing import Protocol

import numpy as np

from pipeline.control.config import SamplingConfig, periods
from pipeline.control.parts import Memory
from pipeline.protocols import Array


class Model[S](Protocol):
    """What a plan is tried on: nominal robots, from what is sensed of the real ones."""

    @property
    def low(self) -> Array:
        """Smallest action, shape (a,)."""
        ...

    @property
    def high(self) -> Array:
        """Largest action, shape (a,)."""
        ...

    def costs(self, sensed: S, command: Array, actions: Array) -> Array:
        """What plans cost.

        Args:
            sensed: where all n robots begin.
            command: what is asked of them, shape (n, c).
            actions: one for each step of each of k plans, shape (n, k, steps, a).

        Returns:
            Costs, shape (n, k); a plan that breaks the simulation costs infinity.
        """
        ...


class Planner:
    """Plans of n robots: each a spline of actions over the horizon, linear between its knots.

    Each time, a plan is first shifted by the time that has passed (its last knot is held), then competes with
    others whose knots lie about it with Gaussian noise; the cheapest one becomes the plan. That is predictive
    sampling (Howell et al. 2022, arXiv 2212.00541, algorithm 1) but for the noise: here the others are of several
    widths, so that one search finds the way and the last millimetres. What robot i tries the k-th time
    follows from the seed, i and k: no generator has to be kept, and no robot depends on its company.

    Args:
        config: sizes.
        start: actions that the first plan holds, shape (n, a).
        low, high: limits of an action, shape (a,).
        seed: of the noise.
    """

    def __init__(self, config: SamplingConfig, start: Array, low: Array, high: Array, seed: int) -> None:
        self._config, self._low, self._high, self._seed = config, low, high, seed
        self._times: Array = np.linspace(0.0, config.horizon_s, config.knots, dtype=np.float64)
        self._spline = weights(self._times, config.step_s * np.arange(config.steps, dtype=np.float64))
        self._shifted = weights(self._times, self._times + 1 / config.plan_hz)
        others = config.samples - 1
        self._width = config.noise * config.narrowest ** (np.arange(others) / max(1, others - 1))
        self.knots: Array = np.repeat(start[:, None], config.knots, axis=1)
        """Shape (n, knots, a)."""
        self._plans = 0

    def better(self, costs: "Costs") -> None:
        """Plan anew, one planning period after the last time."""
        n, others, knots = len(self.knots), len(self._width), self._config.knots
        if self._plans:
            self.knots = self._shifted @ self.knots
        noise = np.stack([np.random.default_rng([self._seed, i, self._plans, 71]).standard_normal(
            (others, knots, self.knots.shape[2])) for i in range(n)])
        tried = np.repeat(self.knots[:, None], others + 1, axis=1)
        tried[:, 1:] = np.clip(tried[:, 1:] + self._width[:, None, None] * noise, self._low, self._high)
        cost = costs(self._spline @ tried)
        self.knots = tried[np.arange(n), np.argmin(cost, axis=1)]
        self._plans += 1

    def at(self, since_s: float) -> Array:
        """Actions of the plans, `since_s` after they were made, shape (n, a)."""
        return (weights(self._times, np.array([since_s])) @ self.knots)[:, 0]

    def save(self) -> Memory:
        """The plans, and how many there were."""
        return {"knots": self.knots.copy(), "plans": np.array([float(self._plans)])}

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        self.knots, self._plans = memory["knots"].copy(), int(memory["plans"][0])


class Costs(Protocol):
    """Costs (n, k) of actions (n, k, steps, a)."""

    def __call__(self, actions: Array) -> Array:
        """What each plan costs."""
        ...


class Mpc[S]:
    """The lower that plans: acts as the newest plan says, and makes a new one `plan_hz` times a second.

    Args:
        config: of the planning.
        model: what plans are tried on.
        start: actions that the first plan holds, shape (n, a).
        lower_hz: how often it is asked to act [Hz], `plan_hz` times a whole number.
        seed: of the noise.
    """

    def __init__(self, config: SamplingConfig, model: Model[S], start: Array, *, lower_hz: float, seed: int) -> None:
        self._model, self._period_s = model, 1 / lower_hz
        self._every = periods(lower_hz, config.plan_hz, "sampling.plan_hz")
        self.planner = Planner(config, start, model.low, model.high, seed)
        self._since = 0

    def act(self, command: Array, sensed: S) -> Array:
        """What the plan says for now."""
        self._since %= self._every
        if self._since == 0:
            self.planner.better(lambda actions: self._model.costs(sensed, command, actions))
        action = self.planner.at(self._since * self._period_s)
        self._since += 1
        return action

    def save(self) -> Memory:
        """The plans, and how old they are."""
        return {**self.planner.save(), "since": np.array([float(self._since)])}

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave."""
        self.planner.load(memory)
        self._since = int(memory["since"][0])


def weights(knots_s: Array, times_s: Array) -> Array:
    """Matrix (times, knots) whose product with knots is their linear spline, held beyond the last one."""
    if len(knots_s) == 1:
        return np.ones((len(times_s), 1))
    columns: list[Array] = [np.interp(times_s, knots_s, one) for one in np.eye(len(knots_s))]
    return np.stack(columns, axis=1)
