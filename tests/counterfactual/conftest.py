"""A robot of known physics, demonstrators as policies, and what a champion recorded at work."""

from collections.abc import Callable

import numpy as np
import pytest

from pipeline.counterfactual.ending import Ending
from pipeline.counterfactual.judging import Attempt, Named, judge
from pipeline.counterfactual.moment import Lab, Moment, moment_of
from pipeline.counterfactual.ride import ride
from pipeline.counterfactual.windows import Window
from pipeline.protocols import Observation
from pipeline.simulation.bodies import arm
from pipeline.simulation.expert import Expert
from pipeline.simulation.model import compose
from pipeline.simulation.physics import UNITS
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from schemas.counterfactual import JudgeConfig
from schemas.episode import Episode, Outcome, Segment
from schemas.recipe import HarvestConfig
from schemas.scene import Draw

CHAMPION, CANDIDATE = "c" * 16, "d" * 16
PHYSICS = {"kp": 0.8, "delay": 2.0, "backlash": 0.004, "noise": 0.0015, "jitter": 0.2, "stiction": 0.6, "mass": 0.09}


class Aiming(Expert):
    """The expert, whose eyes are off by `aside` [m]; 5 cm beside a cube it never believes to be there."""

    def __init__(self, aside: float = 0.0) -> None:
        super().__init__()
        self.aside = aside

    def act(self, observation, ids):
        environment = observation.environment.copy()
        environment[:, 1] += self.aside
        return super().act(Observation(observation.state, environment), ids)

    def restore(self, ids, rows):
        self.offset[ids] = rows


@pytest.fixture(scope="session")
def aiming() -> Callable[..., Aiming]:
    return Aiming


@pytest.fixture(scope="session")
def draws() -> tuple[Draw, ...]:
    """Physics of the robot, noise, jitter and stiction included."""
    return tuple(Draw(name=n, unit=UNITS[n], value=v) for n, v in PHYSICS.items())


@pytest.fixture(scope="session")
def lab() -> Lab:
    return Lab(compose(arm(), "table"))


@pytest.fixture(scope="session")
def recorded(lab, draws) -> Callable[..., list[Attempt]]:
    """Lets a policy work from n starts and records it."""

    def work(policy: Aiming, n: int = 4) -> list[Attempt]:
        scenes = [sample_scene("pick-place", "study", scene_seed("study", 7, i), "common") for i in range(n)]
        world = lab.world(scenes, [draws] * n)
        tracer, ending = Tracer(world), Ending(world, HarvestConfig())
        policy.reset(n)
        rollout(world, policy, watch=ending.tick, tracer=tracer, until_success=False)
        return [(Episode(id=f"{i:016x}", origin="deployed", scene=scene, control_hz=trace.hz, frames=len(trace),
                         outcome=Outcome(label="success", judged_by="sensors"), policy=CHAMPION, generation=0,
                         segments=(Segment(kind="autonomous", start=0, stop=len(trace), actor=CHAMPION),)), trace)
                for i, (scene, trace) in enumerate(zip(scenes, tracer.traces(), strict=True))]

    return work


@pytest.fixture(scope="session")
def attempts(recorded) -> list[Attempt]:
    """Four attempts of a champion that aims well."""
    return recorded(Aiming())


@pytest.fixture(scope="session")
def moments_at(draws) -> Callable[..., list[Moment]]:
    """Moments of attempts, each at a tick of its own."""

    def make(attempts: list[Attempt], ticks: list[int]) -> list[Moment]:
        rides = ride(Aiming(), [t for _, t in attempts])
        return [moment_of(e, t, Window(tick, tick + 1, 0.1), draws, r, r)
                for (e, t), r, tick in zip(attempts, rides, ticks, strict=True)]

    return make


@pytest.fixture(scope="session")
def judged(lab, draws):
    """Judges attempts of one policy in the eyes of another."""

    def run(attempts: list[Attempt], champion: Aiming, candidate: Aiming, lab=lab, **config):
        given = {"threshold": 0.02, "draws": 4} | config
        return judge(attempts, Named(CHAMPION, champion), Named(CANDIDATE, candidate), draws, lab,
                     JudgeConfig(**given), HarvestConfig())

    return run


@pytest.fixture(scope="session")
def close_call(judged, attempts):
    """What came of a candidate that aims 5 cm beside the cube."""
    return judged(attempts, Aiming(), Aiming(0.05))


@pytest.fixture
def same() -> Callable[..., bool]:
    return lambda one, other: np.asarray(one).tobytes() == np.asarray(other).tobytes()
