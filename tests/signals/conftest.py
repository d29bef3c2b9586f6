"""Numbers like those of the arm, and a recording of any length, without a simulator."""

from collections.abc import Callable

import numpy as np
import pytest

from pipeline.protocols import Observation
from pipeline.recording.live_header import beginning
from pipeline.recording.live_rows import Row
from pipeline.trace import Trace
from schemas.episode import Episode
from schemas.scene import SceneSpec

HZ = 20.0


@pytest.fixture(scope="session")
def observations() -> Callable[..., Observation]:
    """n observations around some places, of the size that the arm's have."""

    def made(n: int, seed: int = 0, shift: float = 0.0) -> Observation:
        rng = np.random.default_rng(seed)
        return Observation(rng.normal(shift, 0.1, (n, 16)), rng.normal(shift, 0.1, (n, 7)))

    return made


@pytest.fixture(scope="session")
def begun() -> Callable[..., Episode]:
    """What is known of a recording that starts."""

    def made(hz: float = HZ) -> Episode:
        scene = SceneSpec(family="study", seed=7, robot="arm", scene="table", task="pick-place", stratum="common",
                          object_xy_m=(0.3, 0.1), object_yaw_rad=0.2, object_half_m=0.02, target_xy_m=(0.3, -0.1))
        return beginning(id="00112233445566aa", origin="deployed", scene=scene, control_hz=hz, generation=0,
                         kind="autonomous", actor="policy")

    return made


@pytest.fixture(scope="session")
def row() -> Callable[[int], Row]:
    """What the robot perceived at a tick: its state says which."""

    def made(tick: int) -> Row:
        state = np.full(16, float(tick))
        return Row(state, np.zeros(7), np.zeros(5), np.zeros(7), sim_state=np.ones(3), controller=np.ones(2))

    return made


@pytest.fixture(scope="session")
def trace_with() -> Callable[..., Trace]:
    """A trace of m ticks with signals."""

    def made(m: int = 30, **signals: np.ndarray) -> Trace:
        rng = np.random.default_rng(m)
        return Trace(HZ, rng.random((m, 16)), rng.random((m, 7)), rng.random((m, 5)), rng.random((m, 7)),
                     rng.random((m, 7)), rng.random((m, 7)), (), np.zeros((m, 0, 7)), ("reach",) * m, {},
                     rng.random((m, 4)), rng.random((m, 3)), signals=signals)

    return made
