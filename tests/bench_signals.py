"""What the signals of shadow mode cost a tick of 150 attempts, beside the nearest-neighbour tree that people would use.

The index holds 4,000 frames of 32 features, as in a loop. CPU time of one thread, median of 30.
Run: OMP_NUM_THREADS=1 pytest tests/bench_signals.py -s
"""

import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pipeline.protocols import Observation
from pipeline.signals.neighbours import NEAREST, Neighbours, in_feature_space
from pipeline.signals.tick import Signals

ATTEMPTS, ROUNDS = 150, 30


def cpu_ms(work: Callable[[], object]) -> float:
    """Median CPU time [ms]."""
    taken: list[float] = []
    for _ in range(ROUNDS):
        began = time.process_time()
        work()
        taken.append(time.process_time() - began)
    return float(np.median(taken)) * 1e3


@pytest.fixture(scope="module")
def neighbours() -> Neighbours:
    rng = np.random.default_rng(0)
    way = np.cumsum(rng.normal(scale=0.01, size=(20_000, 23)), axis=0).astype(np.float32)
    return Neighbours.among(way[:, :16], way[:, 16:])


@pytest.fixture(scope="module")
def seen() -> Observation:
    rng = np.random.default_rng(1)
    return Observation(rng.normal(scale=0.3, size=(ATTEMPTS, 16)), rng.normal(scale=0.3, size=(ATTEMPTS, 7)))


def test_distance_beside_a_tree(neighbours: Neighbours, seen: Observation) -> None:
    tree = cKDTree(neighbours.frames)

    def with_a_tree() -> object:
        asked = (in_feature_space(seen.state, seen.environment) - neighbours.mean) / neighbours.scale
        return tree.query(asked, NEAREST)[0].mean(axis=1)

    ours, theirs = cpu_ms(lambda: neighbours.distance(seen)), cpu_ms(with_a_tree)
    print(f"\ndistance of {ATTEMPTS} attempts: {ours:.2f} ms, cKDTree {theirs:.2f} ms ({theirs / ours:.1f} times)")
    assert ours < theirs


def test_all_signals_of_a_tick(neighbours: Neighbours, seen: Observation) -> None:
    rng, ids = np.random.default_rng(2), np.arange(ATTEMPTS)
    signals = Signals(ATTEMPTS, neighbours)
    action, plan, *others = rng.normal(scale=0.01, size=(5, ATTEMPTS, 5))
    answers = {str(k): other for k, other in enumerate(others)}
    all_of_them = cpu_ms(lambda: signals.tick(seen, action, answers, ids, plan))
    distance = cpu_ms(lambda: neighbours.distance(seen))
    print(f"\nall signals of {ATTEMPTS} attempts, 3 candidates: {all_of_them:.2f} ms, distance alone {distance:.2f}")
    assert all_of_them < 50, "one tick of 20 Hz"
