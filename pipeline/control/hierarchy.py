"""Hierarchy: an upper and a lower part on one plant, each at a rate of its own."""

import time

import numpy as np

from pipeline.control.config import periods
from pipeline.control.parts import Lower, Memory, Plant, Upper
from pipeline.protocols import Array


class Hierarchy[S]:
    """Runs n robots: the upper commands every `upper_every` periods of the lower, the lower acts in each of them.

    Within a period of the lower the engine takes several steps with one action held.

    Args:
        plant: the robots.
        upper: gives commands.
        lower: gives actions.
        upper_hz: rate of the upper [Hz], a whole share of `lower_hz`.
        lower_hz: rate of the lower [Hz], a whole share of the engine's steps.

    Raises:
        ConfigError: a rate is no whole share of the one below it.
    """

    def __init__(self, plant: Plant[S], upper: Upper[S], lower: Lower[S], *, upper_hz: float, lower_hz: float) -> None:
        self.plant, self.upper, self.lower = plant, upper, lower
        self.lower_hz = lower_hz
        self._steps = periods(plant.clock_hz, lower_hz, "lower_hz")
        self._upper_every = periods(lower_hz, upper_hz, "upper_hz")
        self.ticks = 0
        """Periods of the lower so far."""
        self.sensed = plant.sense()
        """What was sensed last: before the action of this tick."""
        self.command: Array = np.zeros((plant.n, 0))
        """What is asked for now, shape (n, c); nothing before the first tick."""
        self.lower_cpu_s = 0.0
        """Time that the lower has taken so far, of this process [s]."""

    @property
    def time_s(self) -> float:
        """Since the beginning [s]."""
        return self.ticks / self.lower_hz

    def tick(self) -> Array:
        """One period of the lower; returns the actions sent, shape (n, a)."""
        self.sensed = self.plant.sense()
        if self.ticks % self._upper_every == 0:
            self.command = self.upper.command(self.sensed, self.time_s)
        began = time.process_time()
        action = self.lower.act(self.command, self.sensed)
        self.lower_cpu_s += time.process_time() - began
        self.plant.act(action, self._steps)
        self.ticks += 1
        return action

    def save(self) -> Memory:
        """All that going on from this very moment needs, of every part."""
        parts = {"plant": self.plant.save(), "upper": self.upper.save(), "lower": self.lower.save()}
        kept = {f"{part}/{name}": values.copy() for part, memory in parts.items() for name, values in memory.items()}
        return {**kept, "command": self.command.copy(), "ticks": np.array([float(self.ticks)])}

    def load(self, memory: Memory) -> None:
        """Go on from what `save` gave, bit for bit; the parts must be the same ones."""
        for name, part in (("plant", self.plant), ("upper", self.upper), ("lower", self.lower)):
            part.load({key.removeprefix(f"{name}/"): values.copy() for key, values in memory.items()
                       if key.startswith(f"{name}/")})
        self.command, self.ticks = memory["command"].copy(), int(memory["ticks"][0])

