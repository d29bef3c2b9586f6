"""What candidates cost: a tick of 150 attempts in simulation, and a tick of one robot in real time.

A policy of the loop's own size rides 1, 2 and 4 times beside itself. Beside it the way it was done before: the same
candidates in the champion's process. The clock that waits is measured by wall time; in real time what counts is what
the control thread spends itself. Memory is the proportional set size of a candidate's process.
Run: OMP_NUM_THREADS=1 pytest tests/bench_shadow.py -s
"""

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flows.service.memory import pss_mb
from pipeline.policies.export import build
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.policies.training import fit
from pipeline.protocols import Observation
from pipeline.shadow.riders import Riders
from schemas.recipe import TrainConfig

TICKS, ATTEMPTS, ROUNDS, COUNTS = 150, 150, 5, (1, 2, 4)


class Noise:
    """Nothing to learn: what a policy costs does not depend on what it knows."""

    def sample(self, rng: np.random.Generator, batch: int, chunk: int):
        shapes = ((batch, 16), (batch, 7), (batch, chunk, 5))
        return *(rng.normal(size=shape).astype(np.float32) for shape in shapes), np.ones((batch, chunk), bool)

    def held_out(self, chunk: int):
        return self.sample(np.random.default_rng(0), 32, chunk)


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("policy") / "policy.onnx"
    path.write_bytes(build(fit(Noise(), TrainConfig(steps=2, checkpoint_every=2), seed=0)))
    return path


def spent(act: Callable[[Observation, np.ndarray], object], n: int) -> tuple[float, float]:
    """Median wall time and mean CPU time of this process, a tick [ms]."""
    rng, ids, walls = np.random.default_rng(0), np.arange(n), []
    observation = Observation(rng.normal(size=(n, 16)), rng.normal(size=(n, 7)))
    cpu = time.process_time()
    for _ in range(TICKS):
        began = time.perf_counter()
        act(observation, ids)
        walls.append(time.perf_counter() - began)
    return 1e3 * float(np.median(walls)), 1e3 * (time.process_time() - cpu) / TICKS


def beside(riders: Riders) -> Callable[[Observation, np.ndarray], object]:
    def act(observation: Observation, ids: np.ndarray) -> object:
        riders.offer(observation, ids)
        return riders.answers()

    return act


def test_a_tick_of_150_attempts_in_simulation(file):
    for count in COUNTS:
        with Riders({str(k): file for k in range(count)}, patient=True) as riders:
            riders.ready()
            before = [OnnxPolicy(file) for _ in range(count)]
            walls, cpus = [], []
            for _ in range(ROUNDS):
                riders.reset(ATTEMPTS)
                for policy in before:
                    policy.reset(ATTEMPTS)
                apart = spent(beside(riders), ATTEMPTS)
                within = spent(lambda seen, ids, all=before: [p.act(seen, ids) for p in all], ATTEMPTS)
                walls.append((apart[0], within[0]))
                cpus.append((apart[1], within[1]))
            wall, cpu = np.median(walls, axis=0), np.median(cpus, axis=0)
            memory = [pss_mb(pid) for pid in riders.pids().values()]
            assert set(riders.states().values()) == {"running"}
        print(f"\n{count} candidates: {wall[0]:.2f} ms of wall time a tick, in one process {wall[1]:.2f} ms; of the "
              f"loop's CPU time {cpu[0]:.2f} ms, in one process {cpu[1]:.2f} ms; {np.mean(memory):.0f} MB a candidate")
        assert max(memory) < 100, "four candidates must leave a loop of 1.1 GB below 1.5 GB"
        assert TICKS * (wall[0] - wall[1]) < 3000, "a lap must not take seconds more than it did [ms]"


def test_a_tick_of_one_robot_in_real_time(file):
    period_s = 1 / 200  # ten times the reference robot's rate
    for count in COUNTS:
        with Riders({str(k): file for k in range(count)}, patient=False) as riders:
            riders.ready()
            riders.reset(1)
            rng, ids, own = np.random.default_rng(0), np.arange(1), []
            for _ in range(2 * TICKS):
                observation, began = Observation(rng.normal(size=(1, 16)), rng.normal(size=(1, 7))), time.perf_counter()
                riders.offer(observation, ids)
                offered = time.perf_counter()
                time.sleep(period_s)
                asked = time.perf_counter()
                riders.answers()
                own.append(time.perf_counter() - asked + offered - began)
            print(f"\n{count} candidates: {1e6 * np.median(own):.0f} us of the control thread a tick, 99 % within "
                  f"{1e6 * np.quantile(own, 0.99):.0f} us; {riders.states()} at 200 Hz, load {os.getloadavg()[0]:.1f}")
            assert np.median(own) < 2e-3, "a tick at 20 Hz has 50 ms"
