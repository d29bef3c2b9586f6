"""lerobot's own evaluation command, in a process of its own, against ours on the same starts.

Twenty-four starts by default; HARDCASE_EVAL_EPISODES=200 asks for more.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.lerobot_view.training_data import TrainingData
from pipeline.policies.checkpoint import write_checkpoint
from pipeline.policies.export import export_onnx
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.policies.training import fit
from pipeline.simulation.bodies import load_body
from pipeline.simulation.evaluation import evaluate
from pipeline.simulation.expert import Expert
from pipeline.simulation.gym_env import PickPlaceEnv
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.world import World
from schemas.recipe import TrainConfig
from schemas.scene import SceneSpec

ROOT = Path(__file__).parents[2]
EPISODES = int(os.environ.get("HARDCASE_EVAL_EPISODES", "24"))
DEMONSTRATIONS = 12
"""So few that the policy fails some starts: agreement on nothing but successes would show little."""
CONFIG = TrainConfig(chunk=8, width=96, steps=500, batch=128)


@pytest.fixture(scope="module")
def learnt():
    """A policy that has seen a few demonstrations of the task."""
    scenes = [sample_scene("pick-place", "demo", scene_seed("demo", i), "common") for i in range(DEMONSTRATIONS)]
    world, expert = World(compose(load_body("arm"), "table"), scenes, from_draws([()] * len(scenes))), Expert()
    expert.reset(world.n)
    tracer = Tracer(world)
    rollout(world, expert, tracer=tracer)
    frames = [trace.frames() for trace in tracer.traces()]
    stops = np.cumsum([len(f) for f in frames])
    starts = stops - [len(f) for f in frames]
    state, environment, action = (np.concatenate([getattr(f, name) for f in frames])
                                  for name in ("state", "environment", "action"))
    data = TrainingData(state, environment, action, starts, stops, np.repeat(stops - 1, stops - starts),
                        {"base": np.arange(len(state))}, {"base": 1.0}, np.arange(0))
    return fit(data, CONFIG, seed=1)


def test_lerobot_eval_ends_the_attempts_as_our_own_evaluation_does(tmp_path, learnt):
    write_checkpoint(tmp_path / "policy", learnt, CONFIG)
    export_onnx(learnt, tmp_path / "policy.onnx")
    subprocess.run([
        Path(sys.executable).with_name("lerobot-eval"), f"--policy.path={tmp_path / 'policy'}",
        "--env.discover_packages_path=pipeline.policies", "--env.type=hardcase", f"--eval.n_episodes={EPISODES}",
        f"--eval.batch_size={min(EPISODES, 50)}", "--eval.use_async_envs=false", "--seed=1000",
        f"--output_dir={tmp_path / 'out'}",
    ], cwd=tmp_path, check=True, env={**os.environ, "PYTHONPATH": str(ROOT), "HF_HUB_OFFLINE": "1"})
    told = json.loads((tmp_path / "out" / "eval_info.json").read_text())["per_task"][0]["metrics"]
    env = PickPlaceEnv()
    scenes = [SceneSpec.model_validate_json(env.reset(seed=1000 + k)[1]["scene"]) for k in range(EPISODES)]
    ours = evaluate(OnnxPolicy(tmp_path / "policy.onnx"), scenes, threads=2).success
    agreed = float(np.mean(ours == told["successes"]))
    print(f"{EPISODES} episodes: lerobot-eval {told['successes'].count(True)}, ours {ours.sum()}, agreed {agreed:.3f}")
    assert 0 < ours.sum() < EPISODES
    assert agreed >= 0.95
