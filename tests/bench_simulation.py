"""How fast the simulation is, and where contacts and time steps stop working. Run: pytest -s tests/bench_simulation.py

CPU seconds of this process, so that other programs on the machine disturb little.
"""

import time
from collections.abc import Callable, Iterator

import mujoco
import numpy as np
import pytest

from pipeline.simulation.bodies import arm
from pipeline.simulation.expert import Expert
from pipeline.simulation.model import Setup, compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.rollout import rollout
from pipeline.simulation.scenes import Contact
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.simulation.world import World
from schemas.scene import Draw

N, TICKS, SUBSTEPS, COMPARED = 256, 60, 10, 32
CONTACTS = {
    "pyramidal, impratio 1 (training)": Contact(),
    "elliptic, impratio 3, solref 0.012 (twin)": Contact(elliptic=True, impratio=3, solref=(0.012, 1),
                                                         solimp=(0.9, 0.98, 0.001)),
    "elliptic, impratio 10, solref 0.004": Contact(elliptic=True, impratio=10, solref=(0.004, 1),
                                                   solimp=(0.95, 0.99, 0.001)),
    "elliptic, impratio 10, solref 0.02": Contact(elliptic=True, impratio=10),
}
STEPS_S = (0.0025, 0.005, 0.010, 0.05 / 4, 0.05 / 3, 0.025)


@pytest.fixture(scope="module")
def setup() -> Setup:
    return compose(arm(), "table")


def world(setup: Setup, n: int = N) -> World:
    scenes = [sample_scene("pick-place", "study", scene_seed("study", i), "common") for i in range(n)]
    return World(setup, scenes, from_draws([()] * n), threads=2)


def cpu_s(do: Callable[[], object]) -> float:
    start = time.process_time()
    do()
    return time.process_time() - start


def motion(setup: Setup) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(actions, servo targets) of the expert, tick by tick: reach, grasp, carry and let go."""
    robots, expert, ids = world(setup), Expert(), np.arange(N)
    expert.reset(N)
    for _ in range(TICKS):
        action = expert.act(robots.observe(ids), ids)
        robots.act(action, ids)
        yield action, robots.batch.bind("ctrl").copy()


def test_the_environment_layer_against_mujocos_own_stepping(setup):
    """256 attempts: observe, act, reward and success at 20 Hz, actions known; against `mj_step(nstep=10)` alone."""
    actions, targets = zip(*motion(setup), strict=True)
    ids, data = np.arange(N), mujoco.MjData(setup.model)
    begin = world(setup, COMPARED).batch.state.copy()

    def layer(robots: World) -> None:
        for action in actions:
            robots.observe(ids)
            robots.act(action, ids)
            robots.rewards(ids)
            robots.succeeded(ids)

    def engine() -> None:
        for attempt in range(COMPARED):
            mujoco.mj_setState(setup.model, data, begin[attempt], mujoco.mjtState.mjSTATE_INTEGRATION)
            for target in targets:
                data.ctrl[:] = target[attempt]
                mujoco.mj_step(setup.model, data, nstep=SUBSTEPS)

    ratios = []
    for _ in range(5):
        ours = N * TICKS * SUBSTEPS / cpu_s(lambda robots=world(setup): layer(robots))
        theirs = COMPARED * TICKS * SUBSTEPS / cpu_s(engine)
        ratios.append(ours / theirs)
    print(f"\nenvironment layer {ours:,.0f} substeps a CPU second ({ours / SUBSTEPS:,.0f} ticks), "
          f"mj_step {theirs:,.0f}, ratio {np.median(ratios):.2f} (median of 5, {min(ratios):.2f} to {max(ratios):.2f})")
    assert np.median(ratios) >= 0.8


def test_whole_episodes_with_the_expert(setup):
    """256 attempts from building the world to the last success."""
    def play() -> None:
        robots, expert = world(setup), Expert()
        expert.reset(N)
        assert rollout(robots, expert).success.mean() > 0.95

    rate = N / min(cpu_s(play) for _ in range(3))
    print(f"\nwhole episodes with the expert: {rate:.0f} a CPU second")
    assert rate >= 40


def held(contact: Contact) -> tuple[float, float]:
    """(success of 48 attempts, slip of a lifted cube [mm/s]) with a heavy, smooth cube: 160 g, mu 0.4."""
    heavy = [Draw(name="friction", unit="1", value=0.4), Draw(name="mass", unit="kg", value=0.16)]
    scenes = [sample_scene("pick-place", "study", scene_seed("study", i), "common") for i in range(48)]
    robots = World(compose(arm(), "table", contact), scenes, from_draws([heavy] * 48), threads=2)
    expert, ids = Expert(), np.arange(48)
    expert.reset(48)
    lifted, heights = np.full(48, -1), np.full((100, 48), np.nan)
    success = np.zeros(48, bool)
    for tick in range(100):
        seen = robots.observe(ids)
        action = expert.act(seen, ids)
        first = (lifted < 0) & (robots.truth(ids)[:, 2] > 0.08)
        lifted[first] = tick
        wait = (lifted >= 0) & (tick < lifted + 30)          # a pause of 1.5 s in the air
        action[wait, :4], action[wait, 4] = 0.0, 0.0
        heights[tick] = np.where(wait & (tick >= lifted + 10), robots.truth(ids)[:, 2] - seen.state[:, 9], np.nan)
        robots.act(action, ids)
        success |= robots.succeeded(ids)
    fall = [h[~np.isnan(h)] for h in heights.T]
    slips = [1e3 * (h[0] - h[-1]) * 20 / (len(h) - 1) for h in fall if len(h) > 1]
    return float(success.mean()), float(np.median(slips)) if slips else float("nan")


def test_where_contacts_and_time_steps_stop_working():
    """Success of the expert with a heavy, smooth cube, and how fast it slips out of the grip: the cliffs."""
    print("\n| contact | " + " | ".join(f"{1e3 * step:.3g} ms" for step in STEPS_S) + " |")
    print("|---" * (len(STEPS_S) + 1) + "|")
    table = {}
    for name, contact in CONTACTS.items():
        for step in STEPS_S:
            table[name, step] = held(contact.model_copy(update={"timestep_s": step}))
        cells = (f"{table[name, step][0]:.0%}, {table[name, step][1]:.2f} mm/s" for step in STEPS_S)
        print(f"| {name} | " + " | ".join(cells) + " |")
    for name in list(CONTACTS)[:2]:
        assert table[name, 0.005][0] >= 0.95
