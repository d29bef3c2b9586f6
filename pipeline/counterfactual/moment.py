"""Moment: all that has to be restored to let two policies go on from where they disagreed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from pipeline.counterfactual.ride import Perceived, Ride
from pipeline.counterfactual.variation import vary
from pipeline.counterfactual.windows import Window
from pipeline.protocols import Array
from pipeline.simulation.model import Setup
from pipeline.simulation.physics import from_draws
from pipeline.simulation.world import CONTROLLER_WIDTH, World
from pipeline.trace import Trace
from schemas.episode import Episode
from schemas.scene import Draw, SceneSpec


@dataclass(frozen=True, slots=True)
class Start:
    """Where one branch of a moment begins."""

    draws: tuple[Draw, ...]
    """Its physics."""
    engine: Array
    """State of the engine (mjSTATE_INTEGRATION), shape (nstate,)."""
    controller: Array
    """State of the controller, shape (CONTROLLER_WIDTH,)."""


class Beginning(Protocol):
    """A moment from which both policies can go on, restored or estimated."""

    @property
    def episode(self) -> Episode:
        """Its attempt."""
        ...

    @property
    def trace(self) -> Perceived:
        """What was perceived in it."""
        ...

    @property
    def window(self) -> Window:
        """Where the policies are apart."""
        ...

    @property
    def tick(self) -> int:
        """Where both policies go on."""
        ...

    @property
    def champion(self) -> Array:
        """Memory of the champion before it acts at the tick, shape (w,)."""
        ...

    @property
    def candidate(self) -> Array:
        """Memory of the candidate, had it ridden along."""
        ...

    def start(self, branch: int, seed: int) -> Start:
        """Where a branch begins: its number, and the seed of its draws."""
        ...


@dataclass(frozen=True, slots=True)
class Moment:
    """One tick of one recorded attempt; a Beginning."""

    episode: Episode
    trace: Trace
    window: Window
    draws: tuple[Draw, ...]
    """Physics of the robot that was recorded, as far as it is known."""
    engine: Array
    """State of the engine at the tick (mjSTATE_INTEGRATION), recorded or estimated, shape (nstate,)."""
    controller: Array
    """State of the controller at the tick, shape (CONTROLLER_WIDTH,)."""
    champion: Array
    """Memory of the champion before it acts at the tick, shape (w,)."""
    candidate: Array
    """Memory of the candidate, had it ridden along."""

    @property
    def tick(self) -> int:
        """Where both policies go on."""
        return self.window.start

    def start(self, branch: int, seed: int) -> Start:
        """The recorded state, under physics drawn closely around the recorded robot's."""
        del branch
        return Start(vary(self.draws, seed), self.engine, self.controller)


def moment_of(episode: Episode, trace: Trace, window: Window, draws: tuple[Draw, ...], champion: Ride,
              candidate: Ride) -> Moment:
    """The moment at which a window begins, exactly as it was recorded."""
    at = window.start
    return Moment(episode, trace, window, draws, trace.sim_state[at], trace.controller[at, :CONTROLLER_WIDTH],
                  champion.memory[at], candidate.memory[at])


@dataclass(frozen=True, slots=True)
class Lab:
    """Where moments are restored."""

    setup: Setup
    """Robot, scene and contact model: those of the recorded robot, or a simulation that stands in for it."""
    threads: int = 1

    def world(self, scenes: Sequence[SceneSpec], draws: Sequence[Sequence[Draw]]) -> World:
        """Attempts side by side at their starts, each under its own physics."""
        return World(self.setup, scenes, from_draws(draws), threads=self.threads)
