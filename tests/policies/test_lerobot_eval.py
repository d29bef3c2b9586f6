"""lerobot's own evaluation command, in a process of its own, against ours on the same starts."""

import json
import os
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from pipeline.policies.checkpoint import write_checkpoint
from pipeline.policies.export import export_onnx
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.protocols import Observation

ROOT = Path(__file__).parents[2]
register = pytest.importorskip("pipeline.simulation.register")


def test_lerobot_eval_ends_every_attempt_as_our_own_evaluation_does(tmp_path, fitted, small):
    write_checkpoint(tmp_path / "policy", fitted, small)
    export_onnx(fitted, tmp_path / "policy.onnx")
    subprocess.run([
        Path(sys.executable).with_name("lerobot-eval"), f"--policy.path={tmp_path / 'policy'}",
        "--env.discover_packages_path=pipeline.policies", "--env.type=hardcase", "--eval.n_episodes=4",
        "--eval.batch_size=2", "--eval.use_async_envs=false", "--seed=1000", f"--output_dir={tmp_path / 'out'}",
    ], cwd=tmp_path, check=True, env={**os.environ, "PYTHONPATH": str(ROOT), "HF_HUB_OFFLINE": "1"})
    told = json.loads((tmp_path / "out" / "eval_info.json").read_text())["per_task"][0]["metrics"]
    if "hardcase/PickPlace-v0" not in gym.registry:
        register.register()
    env, policy = gym.make("hardcase/PickPlace-v0", max_episode_steps=200), OnnxPolicy(tmp_path / "policy.onnx")
    ours: list[tuple[bool, float]] = []
    for seed in range(1000, 1004):
        policy.reset(1)
        seen, info = env.reset(seed=seed)
        rewards, over = 0.0, False
        while not over:
            observation = Observation(seen["agent_pos"][None], seen["environment_state"][None])
            action = policy.act(observation, np.array([0]))[0]
            seen, reward, terminated, truncated, info = env.step(action.astype(np.float32))
            rewards, over = rewards + float(reward), terminated or truncated
        ours.append((bool(info["is_success"]), rewards))
    assert told["successes"] == [success for success, _ in ours]
    assert np.allclose(told["sum_rewards"], [rewards for _, rewards in ours], rtol=1e-2, atol=0.1)
