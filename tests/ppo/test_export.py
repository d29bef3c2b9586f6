"""The exported policy is the trained one, needs no torch, and refuses what is not for it."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper

from pipeline.errors import PolicyError
from pipeline.ppo.runner import OnnxRunner

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def policy(straight, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("policy") / "policy.onnx"
    assert straight.export(path) < 1e-5
    return path


def test_it_gives_what_sb3_gives_for_what_the_robots_sense(straight, policy):
    sensed = straight.env.attempts.world.observe()
    expected, _ = straight.model.predict(straight.env.normaliser(sensed), deterministic=True)
    assert np.allclose(OnnxRunner(policy)(sensed), expected, rtol=0, atol=1e-5)


def test_an_action_does_not_depend_on_its_company(straight, policy):
    sensed, runner = straight.env.attempts.world.observe(), OnnxRunner(policy)
    assert all(np.array_equal(runner(sensed[i : i + 1])[0], runner(sensed)[i]) for i in range(len(sensed)))


def test_equal_weights_give_equal_bytes(straight, policy, tmp_path):
    straight.export(tmp_path / "again.onnx")
    assert (tmp_path / "again.onnx").read_bytes() == policy.read_bytes()


def test_it_runs_without_torch_and_sb3(policy):
    code = (f"import sys, numpy, pathlib; from pipeline.ppo.runner import OnnxRunner; "
            f"r = OnnxRunner(pathlib.Path({str(policy)!r})); print(r(numpy.zeros((1, r.width), 'f4')).shape); "
            "assert not {'torch', 'stable_baselines3'} & set(sys.modules)")
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "(1, 10)"


def test_weights_that_onnx_cannot_follow_leave_no_file(straight, tmp_path):
    weight = straight.model.policy.action_net.weight
    before = weight.detach().clone()
    with torch.no_grad():
        weight.mul_(1e9)
    with pytest.raises(PolicyError, match="mend: train again"):
        straight.export(tmp_path / "policy.onnx")
    with torch.no_grad():
        weight.copy_(before)
    assert not list(tmp_path.iterdir())


def test_a_robot_that_senses_otherwise_is_refused(policy):
    with pytest.raises(PolicyError, match=r"takes 39 values, the robot senses 41.*\n.*\n  mend: .*rl train --body"):
        OnnxRunner(policy)(np.zeros((1, 41), np.float32))


@pytest.mark.parametrize(("name", "change", "told"), [
    ("policy.onnx", lambda data: data[:50], "not an ONNX file"),
    ("policy.pt", lambda data: data, "pickle where a model is expected"),
    ("other.onnx", lambda data: foreign("Gemm", "seen"), "expected are 'observation'"),
    ("hostile.onnx", lambda data: foreign("If", "observation"), "operator 'If' is not allowed"),
], ids=["cut off", "pickle", "other inputs", "a branch"])
def test_a_file_that_is_no_policy_is_refused(policy, tmp_path, name, change, told):
    (tmp_path / name).write_bytes(change(policy.read_bytes()))
    with pytest.raises(PolicyError, match=told):
        OnnxRunner(tmp_path / name)


def foreign(op: str, name: str) -> bytes:
    rows = [helper.make_tensor_value_info(n, TensorProto.FLOAT, ["n", 2]) for n in (name, "action")]
    node = helper.make_node(op, [name, name], ["action"])
    graph = helper.make_graph([node], "g", rows[:1], rows[1:])
    model: onnx.ModelProto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)])
    return model.SerializeToString()
