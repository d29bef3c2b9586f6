"""The Gymnasium environment and its vector form, by Gymnasium's own checker and against each other."""

import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

from pipeline.errors import ConfigError, SimulationError
from pipeline.protocols import Observation
from pipeline.simulation.expert import Expert
from pipeline.simulation.gym_env import PickPlaceEnv
from pipeline.simulation.register import ID, TICKS, register
from pipeline.simulation.tasks import TASKS, sample_scene, scene_seed
from pipeline.simulation.vector_env import PickPlaceVectorEnv
from schemas.scene import SceneSpec

pytestmark = pytest.mark.filterwarnings("error")
ROOT = Path(__file__).parents[2]
NOTHING = np.array([0, 0, 0, 0, 0.08], np.float32)


@pytest.fixture(scope="module", autouse=True)
def registered():
    register()
    register()


def same(one: object, other: object) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    return type(one) is type(other) and np.array_equal(one, other)


def drive(env: gym.Env, seed: int | None = None, **options: object):
    """An episode by the expert: (observations, rewards, info of the last step)."""
    expert, ids = Expert(), np.array([0])
    expert.reset(1)
    seen, info = env.reset(seed=seed, options=options)
    path, rewards, over = [seen], [], False
    while not over:
        action = expert.act(Observation(seen["agent_pos"][None], seen["environment_state"][None]), ids)[0]
        seen, reward, terminated, truncated, info = env.step(action.astype(np.float32))
        path.append(seen)
        rewards.append(reward)
        over = terminated or truncated
    return path, rewards, info


@pytest.mark.parametrize("randomize", [False, True], ids=["nominal", "randomized"])
def test_gymnasiums_own_checker_has_nothing_to_say(randomize):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(ID, randomize=randomize, render_mode="rgb_array")
        check_env(env.unwrapped)
        env.close()


def test_the_module_before_the_colon_registers_in_a_fresh_process():
    code = ("import sys, gymnasium as gym, pipeline.simulation.register as r; r.register(); assert gym.spec(r.ID); "
            "assert 'mujoco' not in sys.modules; gym.registry.pop(r.ID); "
            "print(gym.make('pipeline.simulation.registered:hardcase/PickPlace-v0').spec.max_episode_steps)")
    told = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True)
    assert told.stdout.strip() == "150"


def test_the_registered_limit_is_the_tasks_own():
    assert TASKS["pick-place"].ticks == TICKS


def test_the_expert_ends_an_episode_with_a_success_and_the_same_seed_gives_it_again():
    env = gym.make(ID)
    path, rewards, info = drive(env, seed=3)
    again, rewards_again, _ = drive(env, seed=3)
    other, _, _ = drive(env, seed=4)
    assert info["is_success"]
    assert info["reward_terms"]["success"] == TASKS["pick-place"].weights["success"]
    assert rewards[-1] == pytest.approx(sum(info["reward_terms"].values()))
    assert rewards == rewards_again
    assert all(same(a, b) for a, b in zip(path, again, strict=True))
    assert not same(path[0], other[0])


def test_an_attempt_that_does_nothing_is_cut_at_the_limit():
    env = gym.make(ID, max_episode_steps=1000)
    env.reset(seed=0)
    for tick in range(TICKS):
        _, _, terminated, truncated, info = env.step(NOTHING)
        assert (terminated, truncated) == (False, tick == TICKS - 1)
    assert not info["is_success"]
    with pytest.raises(SimulationError, match=r"mend: call reset\(\) first"):
        env.step(NOTHING)


def test_a_scene_is_played_as_it_stands():
    env = gym.make(ID)
    spec = sample_scene("pick-place", "gate", scene_seed("gate", 5), "large")
    seen, info = env.reset(options={"scene": spec})
    assert SceneSpec.model_validate_json(info["scene"]) == spec
    assert np.allclose(seen["environment_state"][[0, 1, 4, 5]], [*spec.object_xy_m, *spec.target_xy_m])
    assert seen["environment_state"][2] == pytest.approx(spec.object_half_m)


@pytest.mark.parametrize(("change", "mend"), [
    ({"task": "stack"}, "task='stack'"), ({"robot": "crane"}, "robot='crane'"), ({"twin": 100}, "'twin': None"),
], ids=["other task", "other robot", "a twin's"])
def test_a_scene_it_cannot_play_is_refused(change, mend):
    spec = sample_scene("pick-place", "gate", scene_seed("gate", 5), "common").model_copy(update=change)
    with pytest.raises(ConfigError, match=f"mend: .*{mend}"):
        PickPlaceEnv().reset(options={"scene": spec})


@pytest.mark.parametrize(("word", "names"), [
    ({"robot": "crane"}, "arm"), ({"scene": "floor"}, "table"), ({"task": "stack"}, "pick-place"),
    ({"stratum": "tiny"}, "beside, common, large"),
], ids=["robot", "scene", "task", "stratum"])
def test_a_wrong_name_lists_every_valid_one(word, names):
    with pytest.raises(ConfigError, match=f"mend: use one of: .*{names}"):
        gym.make(ID, **word)


@pytest.mark.parametrize(("action", "mend"), [
    (np.zeros(4), "send dx, dy, dz, dyaw, gripper"), (np.full(5, np.nan), "look at the policy"),
], ids=["too short", "not a number"])
def test_an_action_it_cannot_take_is_refused(action, mend):
    env = PickPlaceEnv()
    env.reset(seed=0)
    with pytest.raises(SimulationError, match=f"mend: {mend}"):
        env.step(action)


def test_steps_and_pictures_before_the_first_reset_say_what_to_do():
    env = PickPlaceEnv(render_mode="rgb_array")
    for call in (lambda: env.step(NOTHING), env.render):
        with pytest.raises(SimulationError, match=r"mend: call reset\(\) first"):
            call()
    with pytest.raises(ConfigError, match=r"mend: call reset\(\) first"):
        PickPlaceVectorEnv(2).step(np.tile(NOTHING, (2, 1)))


def test_a_picture_shows_the_cube_in_its_own_size():
    env = PickPlaceEnv(render_mode="rgb_array")
    red = {}
    for stratum in ("common", "large"):
        spec = sample_scene("pick-place", "gate", scene_seed("gate", 5), stratum)
        env.reset(options={"scene": spec.model_copy(update={"object_xy_m": (0.3, 0.0), "object_yaw_rad": 0.0})})
        picture = env.render().astype(int)
        red[stratum] = int(((picture[..., 0] > 2 * picture[..., 1]) & (picture[..., 0] > 90)).sum())
    env.close()
    assert picture.shape == (240, 320, 3)
    assert red["large"] > 1.5 * red["common"] > 0


def test_the_vector_form_equals_single_environments_step_for_step():
    n, words = 5, {"randomize": True, "max_episode_steps": 60}
    ours = gym.make_vec(ID, n, **words)
    theirs = SyncVectorEnv([lambda: gym.make(ID, **words) for _ in range(n)])
    assert isinstance(ours, PickPlaceVectorEnv)
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    assert (ours.observation_space, ours.action_space) == (theirs.observation_space, theirs.action_space)
    expert, ids = Expert(), np.arange(n)
    expert.reset(n)
    (seen, info), (seen_too, info_too) = ours.reset(seed=40), theirs.reset(seed=40)
    successes = ends = 0
    for _ in range(130):
        assert same(seen, seen_too)
        assert same(info, info_too)
        action = expert.act(Observation(seen["agent_pos"], seen["environment_state"]), ids).astype(np.float32)
        seen, reward, terminated, truncated, info = ours.step(action)
        seen_too, *flags, info_too = theirs.step(action)
        assert same(reward, flags[0])
        assert same(terminated, flags[1])
        assert same(truncated, flags[2])
        expert.offset[terminated | truncated] = 0
        successes, ends = successes + terminated.sum(), ends + (terminated | truncated).sum()
    assert successes >= 5
    assert ends > successes  # some were cut, so that both ways to end and to begin anew were met


def test_the_vector_form_plays_given_scenes_and_counts_them():
    specs = [sample_scene("pick-place", "gate", scene_seed("gate", i), "common") for i in range(3)]
    env = PickPlaceVectorEnv(3)
    _, info = env.reset(options={"scenes": specs})
    assert [SceneSpec.model_validate_json(s) for s in info["scene"]] == specs
    with pytest.raises(ConfigError, match="mend: give 3 scenes"):
        env.reset(options={"scenes": specs[:2]})
    with pytest.raises(ConfigError, match="mend: give 3 seeds"):
        env.reset(seed=[1, 2])
