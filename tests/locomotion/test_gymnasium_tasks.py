"""Hopper and HalfCheetah on one Batch are Gymnasium's own, bit for bit."""

import gymnasium as gym
import numpy as np
import pytest

from pipeline.errors import ConfigError, SimulationError
from pipeline.locomotion.gymnasium_tasks import EPISODE_TICKS, GYMNASIUM_TASKS, GymnasiumWorld

STATE = ("qpos", "qvel", "qacc_warmstart")


def state_of(env):
    data = env.unwrapped.data
    return [data.time, *(getattr(data, name).copy() for name in STATE)]


@pytest.mark.parametrize("n", [1, 4], ids=["alone", "four side by side"])
@pytest.mark.parametrize("name", GYMNASIUM_TASKS)
def test_every_step_and_every_new_start_is_gymnasiums_own(name, n):
    world, envs = GymnasiumWorld(name, n), [gym.make(name) for _ in range(n)]
    begun = np.stack([env.reset(seed=7 + i)[0] for i, env in enumerate(envs)])
    assert np.array_equal(world.begin(range(7, 7 + n)), begun)
    rng, (low, high), ended = np.random.default_rng(0), world.action_range, 0
    for _ in range(2100):
        action = np.clip(rng.normal(0, 0.5, (n, world.action_size)), low, high).astype(np.float32)
        tick = world.step(action)
        for i, env in enumerate(envs):
            seen, reward, terminated, truncated, _ = env.step(action[i])
            assert (reward, terminated, truncated) == (tick.reward[i], tick.terminated[i], tick.truncated[i])
            if terminated or truncated:
                assert np.array_equal(seen, tick.last[list(tick.ended).index(i)])
                seen, ended = env.reset()[0], ended + 1
            assert np.array_equal(seen, tick.observation[i])
            for theirs, ours in zip(state_of(env), ("time", *STATE), strict=True):
                assert np.array_equal(theirs, world.batch.bind(ours)[i]), ours
    assert ended >= 2 * n


def test_a_hopper_that_stands_to_the_end_is_truncated_as_gymnasium_does_it():
    world, env = GymnasiumWorld("Hopper-v5", 1), gym.make("Hopper-v5", max_episode_steps=5)
    world.begin([1])
    env.reset(seed=1)
    world.ticks[:] = EPISODE_TICKS - 5
    still, flags = np.zeros((1, 3), np.float32), []
    for _ in range(5):
        tick = world.step(still)
        flags.append((bool(tick.terminated[0]), bool(tick.truncated[0])))
        assert flags[-1] == env.step(still[0])[2:4]
    assert flags[-1] == (False, True)


def test_a_world_goes_on_from_what_it_saved():
    action = np.full((2, 3), 0.3, np.float32)
    world = GymnasiumWorld("Hopper-v5", 2)
    world.begin([5, 6])
    for _ in range(20):
        world.step(action)
    saved, other = world.save(), GymnasiumWorld("Hopper-v5", 2)
    other.load(saved)
    for _ in range(60):  # beyond the next starts, which the generators draw
        ours, theirs = world.step(action), other.step(action)
        assert np.array_equal(ours.observation, theirs.observation)
        assert np.array_equal(ours.reward, theirs.reward)


def test_wrong_words_are_told_with_their_mend():
    with pytest.raises(ConfigError, match="mend: use one of: HalfCheetah-v5, Hopper-v5"):
        GymnasiumWorld("Ant-v5", 1)
    world = GymnasiumWorld("Hopper-v5", 2)
    with pytest.raises(SimulationError, match=r"mend: call begin\(\[0, 1"):
        world.step(np.zeros((2, 3), np.float32))
    with pytest.raises(ConfigError, match="1 seeds for 2 episodes"):
        world.begin([0])
    with pytest.raises(ConfigError, match=r"mend: give one seed for each"):
        world.begin()
    with pytest.raises(SimulationError, match="one value for each motor"):
        world.step(np.zeros((2, 4), np.float32))
