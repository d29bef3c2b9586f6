"""The checkpoint against lerobot itself: its own writer, its own factory, its own processors."""

import numpy as np
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors

from pipeline.errors import PolicyError
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.policies.checkpoint import write_checkpoint
from pipeline.policies.chunked import ChunkedConfig, ChunkedPolicy, make_chunked_pre_post_processors
from pipeline.policies.export import export_onnx
from pipeline.policies.lerobot_env import HardcaseEnv
from pipeline.policies.network import tensor
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.protocols import Observation


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, fitted, small):
    folder = tmp_path_factory.mktemp("checkpoint")
    write_checkpoint(folder, fitted, small)
    return folder


@pytest.fixture(scope="module")
def loaded(checkpoint):
    config = PreTrainedConfig.from_pretrained(checkpoint)
    config.pretrained_path = checkpoint
    return make_policy(config, env_cfg=HardcaseEnv()), *make_pre_post_processors(config, str(checkpoint))


def observations(n: int, seed: int) -> Observation:
    rng = np.random.default_rng(seed)
    return Observation(rng.normal(0, 0.1, (n, len(STATE))), rng.normal(0, 0.1, (n, len(ENVIRONMENT))))


def test_every_file_is_what_lerobot_would_have_written(tmp_path, checkpoint, fitted, small):
    policy = ChunkedPolicy(ChunkedConfig(chunk=small.chunk, width=small.width, depth=small.depth,
                                         learning_rate=small.learning_rate))
    policy.net.load(fitted.weights)
    statistics = {"action": {"mean": tensor(fitted.action_mean), "std": tensor(fitted.action_std)}}
    policy.save_pretrained(tmp_path)
    for pipeline in make_chunked_pre_post_processors(policy.config, statistics):
        pipeline.save_pretrained(tmp_path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == \
        {p.name: p.read_bytes() for p in checkpoint.iterdir()}


def test_lerobots_factory_loads_the_policy_with_its_weights(loaded, fitted):
    policy = loaded[0]
    assert type(policy) is ChunkedPolicy
    for name, values in policy.net.weights().items():
        assert (values == fitted.weights[name]).all()


def test_lerobots_pipeline_acts_as_the_onnx_policy_does(tmp_path, loaded, fitted):
    policy, before, after = loaded
    export_onnx(fitted, tmp_path / "policy.onnx")
    ours = OnnxPolicy(tmp_path / "policy.onnx")
    for attempt in range(2):  # the second time shows that reset() forgets
        policy.reset()
        ours.reset(3)
        for tick in range(8):
            seen = observations(3, seed=10 * attempt + tick)
            batch = before({"observation.state": tensor(seen.state).float(),
                            "observation.environment_state": tensor(seen.environment).float()})
            action = after(policy.select_action(batch))
            assert action.shape == (3, len(ACTION))
            assert np.abs(action.numpy() - ours.act(seen, np.arange(3))).max() < 1e-6


def test_lerobots_training_loss_is_ours(loaded, reaching, fitted, small):
    policy = loaded[0]
    state, environment, actions, mask = reaching.held_out(small.chunk)
    loss, report = policy.forward({
        "observation.state": tensor(state), "observation.environment_state": tensor(environment),
        "action": tensor((actions - fitted.action_mean) / fitted.action_std), "action_is_pad": tensor(~mask)})
    assert loss.item() == pytest.approx(fitted.held_out_loss[-1][1], rel=1e-3)
    assert report == {"smooth_l1": loss.item()}
    loss.backward()
    assert all(torch.isfinite(p.grad).all() for p in policy.get_optim_params())


def test_a_checkpoint_is_never_overwritten(checkpoint, fitted, small):
    with pytest.raises(PolicyError, match=r"already(.|\n)*mend: write to another folder"):
        write_checkpoint(checkpoint, fitted, small)
