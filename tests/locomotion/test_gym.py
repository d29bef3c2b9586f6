"""The legged environments by Gymnasium's own checker, against each other, and with bad input."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

from pipeline.errors import ConfigError, SimulationError
from pipeline.locomotion.tasks import LEGGED_TASKS
from pipeline.locomotion.vector_env import LeggedVectorEnv
from pipeline.simulation.register import LEGGED, LEGGED_TICKS

pytestmark = pytest.mark.filterwarnings("error")


def same(one: object, other: object) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    return np.array_equal(one, other)


@pytest.mark.parametrize("name", LEGGED)
def test_gymnasiums_own_checker_has_nothing_to_say(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(name, render_mode="rgb_array")
        check_env(env.unwrapped)
        env.close()


@pytest.mark.parametrize("name", ["unitree_h1", "unitree_g1"])
def test_another_body_is_another_word(menagerie, name):
    env = gym.make("hardcase/Stand-v0", body=name)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    _, reward, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
    assert reward > 0


def test_the_registered_limit_is_the_tasks_own():
    assert {LEGGED_TASKS[task].ticks for task in LEGGED.values()} == {LEGGED_TICKS}


def test_the_same_seed_gives_the_attempt_again_and_so_does_its_start():
    env = gym.make("hardcase/Stand-v0")
    first, info = env.reset(seed=3)
    other, _ = env.reset()
    assert not np.array_equal(first, other)
    assert np.array_equal(env.reset(options={"start": info["start"]})[0], first)
    assert np.array_equal(env.reset(seed=3)[0], first)


def test_a_reward_is_the_sum_of_its_terms_and_the_truth_is_marked_as_such():
    env = gym.make("hardcase/Walk-v0")
    seen, _ = env.reset(seed=0)
    _, reward, _, _, info = env.step(np.zeros(10, np.float32))
    assert reward == pytest.approx(sum(info["reward_terms"].values()))
    assert list(info["reward_terms"]) == list(LEGGED_TASKS["walk"].weights)
    assert info["privileged"].keys() == {"velocity", "height", "contact"}
    assert seen.shape == (3 + 3 + 3 * 10 + 3 + 2,)  # IMU, encoders and last action, command, clock: no height, no speed


def test_an_attempt_ends_in_a_fall_and_then_asks_for_a_reset():
    env = gym.make("hardcase/Stand-v0")
    env.reset(seed=1)
    over = False
    while not over:
        _, _, over, truncated, _ = env.step(np.zeros(10, np.float32))
    assert not truncated
    with pytest.raises(SimulationError, match=r"mend: call reset\(\) first"):
        env.unwrapped.step(np.zeros(10, np.float32))


def test_the_vector_form_equals_single_environments_step_for_step():
    n, words = 5, {"max_episode_steps": 70}
    ours, theirs = gym.make_vec("hardcase/Stand-v0", n, threads=1, **words), SyncVectorEnv(
        [lambda: gym.make("hardcase/Stand-v0", **words) for _ in range(n)])
    assert isinstance(ours, LeggedVectorEnv)
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    assert (ours.observation_space, ours.action_space) == (theirs.observation_space, theirs.action_space)
    (seen, info), (seen_too, info_too) = ours.reset(seed=40), theirs.reset(seed=40)
    rng, fell, cut = np.random.default_rng(0), 0, 0
    for _ in range(160):
        assert same(seen, seen_too)
        assert same(info, info_too)
        action = rng.uniform(-0.1, 0.1, (n, 10)).astype(np.float32)
        seen, *ends, info = ours.step(action)
        seen_too, *ends_too, info_too = theirs.step(action)
        assert all(same(a, b) for a, b in zip(ends, ends_too, strict=True))
        fell, cut = fell + ends[1].sum(), cut + ends[2].sum()
    assert fell and cut  # both ways to end, and to begin anew, were met


@pytest.mark.parametrize(("words", "names"), [
    ({"body": "biper"}, "biped, unitree_g1, unitree_h1"), ({"task": "dance"}, "stand, walk"),
    ({"stratum": "flying"}, "leaning"),
], ids=["body", "task", "stratum"])
def test_a_wrong_name_lists_every_valid_one(words, names):
    with pytest.raises(ConfigError, match=f"mend: use one of: .*{names}"):
        gym.make("hardcase/Stand-v0", **words)


@pytest.mark.parametrize(("action", "mend"), [
    (np.zeros(4), "send one share .* left_hip_roll"), (np.full(10, np.nan), "look at the policy"),
], ids=["too short", "not a number"])
def test_an_action_it_cannot_take_is_refused(action, mend):
    env = gym.make("hardcase/Stand-v0").unwrapped
    env.reset(seed=0)
    with pytest.raises(SimulationError, match=f"mend: {mend}"):
        env.step(action)


def test_steps_and_pictures_before_the_first_reset_say_what_to_do():
    env = gym.make("hardcase/Stand-v0", render_mode="rgb_array").unwrapped
    many = LeggedVectorEnv(2)
    for call in (lambda: env.step(np.zeros(10)), env.render, lambda: many.step(np.zeros((2, 10)))):
        with pytest.raises(SimulationError, match=r"mend: call reset\(\) first"):
            call()


def test_seeds_and_starts_are_counted():
    many = LeggedVectorEnv(3)
    for words, mend in (({"seed": [1, 2]}, "give 3 seeds"), ({"options": {"start": [1]}}, "give 3 starts")):
        with pytest.raises(ConfigError, match=f"mend: {mend}"):
            many.reset(**words)


def test_a_picture_shows_the_robot_standing_in_it():
    env = gym.make("hardcase/Stand-v0", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render().astype(int)
    env.close()
    assert picture.shape == (240, 320, 3)
    blue = (picture[..., 2] > 1.4 * picture[..., 0]) & (picture[..., 2] > 60)
    columns = np.nonzero(blue)[1]
    assert blue.mean() > 0.005
    assert abs(columns.mean() - 160) < 40  # the camera follows it
