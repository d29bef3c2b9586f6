"""Environment steps a CPU second, and SB3 with our vector environment beside its own. Run: pytest -s tests/bench_rl.py

The first is CPU time of the process, so that other programs on the machine disturb little. The second is wall time,
as SB3's SubprocVecEnv works in processes of its own: the three take turns in short trainings, and medians are compared.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv
from torch import nn, set_num_threads

from pipeline.locomotion.attempts import Attempts
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.tasks import load_legged_task
from pipeline.ppo.config import PPO_CONFIGS, Order
from pipeline.ppo.reference import Arm
from pipeline.ppo.reference_envs import ARMS
from pipeline.ppo.training import Training

STEPS, PROCESSES, ROUNDS = 16_384, 2, 3
PPO_NUMBERS = PPO_CONFIGS["stand"].model_copy(update={"steps": STEPS})
ASKED_STEPS, ASKED_RATIO = 15_000, 2.0


made = partial(gym.make, "pipeline.simulation.registered:hardcase/Stand-v0")
"""Makes one environment; found again by name in a process of its own."""


@pytest.mark.parametrize("name", ["stand", "walk"])
def test_environment_steps_a_cpu_second(name):
    """128 bipeds that begin anew when they fall, small random actions: act, observe, judge, reward."""
    attempts = Attempts(load_legged("biped"), load_legged_task(name), 128, seed=0)
    attempts.begin()
    action = np.random.default_rng(0).uniform(-0.2, 0.2, (128, 10))
    rates = []
    for _ in range(5):
        began = time.process_time()
        for _ in range(60):
            attempts.step(action)
        rates.append(60 * 128 / (time.process_time() - began))
    print(f"\n{name}: {median(rates):,.0f} environment steps a CPU second")
    assert median(rates) > ASKED_STEPS


def test_sb3_with_ours_beside_dummy_and_subproc():
    """PPO of equal numbers on 16,384 steps of Stand: ours, and SB3's vector environments over Stand-v0 one by one."""
    set_num_threads(1)
    dummy, subproc = DummyVecEnv([made] * PROCESSES), SubprocVecEnv([made] * PROCESSES, start_method="forkserver")
    wide = DummyVecEnv([made] * PPO_NUMBERS.attempts)
    runs: dict[str, Callable[[], object]] = {
        "ours": ours, f"DummyVecEnv, {PROCESSES}": lambda: theirs(dummy),
        f"DummyVecEnv, {PPO_NUMBERS.attempts}": lambda: theirs(wide),
        f"SubprocVecEnv, {PROCESSES}": lambda: theirs(subproc)}
    took: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(ROUNDS):
        for name, run in runs.items():
            began = time.monotonic()
            run()
            took[name].append(time.monotonic() - began)
    for env in (dummy, subproc, wide):
        env.close()
    mine = median(took["ours"])
    print()
    for name, several in took.items():
        print(f"{name}: {median(several):.1f} s, {STEPS / median(several):,.0f} steps/s, "
              f"{median(several) / mine:.1f} times ours")
        assert name == "ours" or median(several) > ASKED_RATIO * mine


def ours() -> None:
    order = Order(body="biped", name="stand", task=load_legged_task("stand"), ppo=PPO_NUMBERS)
    with TemporaryDirectory() as folder:
        Training(order, Path(folder)).run()


def theirs(env: VecEnv) -> None:
    """The same updates: as many samples an iteration, batches, epochs and layers."""
    n = PPO_NUMBERS
    PPO("MlpPolicy", env, n_steps=n.iteration // env.num_envs, batch_size=n.batch, n_epochs=n.epochs, gamma=n.gamma,
        device="cpu", policy_kwargs={"net_arch": list(n.hidden), "activation_fn": nn.ELU}).learn(n.steps)


@pytest.mark.parametrize("name", ["Hopper-v5", "HalfCheetah-v5"])
def test_gymnasiums_tasks_on_one_batch_beside_dummy(name):
    """Random actions, new starts included, one thread: the reference's vector environments, alone and 64 wide."""
    rates: dict[tuple[Arm, int], float] = {}
    for n, ticks in ((1, 1500), (64, 40)):
        for arm, make in ARMS.items():
            env = make(name, n)
            env.seed(0)
            env.reset()
            actions = np.random.default_rng(0).uniform(-1, 1, (ticks, n, *env.action_space.shape)).astype(np.float32)
            took = []
            for _ in range(ROUNDS):
                began = time.process_time()
                for action in actions:
                    env.step(action)
                took.append(time.process_time() - began)
            rates[arm, n] = n * ticks / median(took)
            env.close()
    print()
    for n in (1, 64):
        print(f"{name}, {n} wide: ours {rates['ours', n]:,.0f} environment steps a CPU second, DummyVecEnv "
              f"{rates['dummy', n]:,.0f}, ratio {rates['ours', n] / rates['dummy', n]:.2f}")
    assert rates["ours", 64] > rates["dummy", 64]
