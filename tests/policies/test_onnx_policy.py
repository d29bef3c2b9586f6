import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.frames import ENVIRONMENT, STATE
from pipeline.policies.export import export_onnx
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.protocols import Observation, Policy

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def file(tmp_path_factory, fitted):
    path = tmp_path_factory.mktemp("onnx") / "policy.onnx"
    export_onnx(fitted, path)
    return path


def observed(n: int, seed: int = 0) -> Observation:
    rng = np.random.default_rng(seed)
    return Observation(rng.normal(0, 0.1, (n, len(STATE))), rng.normal(0, 0.1, (n, len(ENVIRONMENT))))


def rows(seen: Observation, ids: np.ndarray) -> Observation:
    return Observation(seen.state[ids], seen.environment[ids])


def test_an_attempt_acts_alike_alone_and_in_any_company(file):
    rng, n = np.random.default_rng(0), 37
    together, alone = OnnxPolicy(file), OnnxPolicy(file)
    together.reset(n)
    alone.reset(n)
    for tick in range(6):
        seen = observed(n, tick)
        ids = rng.permutation(n)
        actions = together.act(rows(seen, ids), ids)
        for place, k in enumerate(ids):
            one = np.array([k])
            assert (alone.act(rows(seen, one), one)[0] == actions[place]).all()


def test_a_restored_attempt_acts_as_if_it_had_never_stopped(file):
    policy: Policy = OnnxPolicy(file)
    other = OnnxPolicy(file)
    policy.reset(4)
    other.reset(9)
    for tick in range(3):
        policy.act(observed(4, tick), np.arange(4))
    other.restore(np.array([7]), policy.memory(np.array([2])))
    for tick in range(3, 8):
        seen = observed(4, tick)
        expected = policy.act(seen, np.arange(4))[2]
        assert (other.act(rows(seen, np.array([2])), np.array([7]))[0] == expected).all()


def test_no_attempts_need_no_actions(file):
    policy = OnnxPolicy(file)
    policy.reset(3)
    assert policy.act(observed(0), np.zeros(0, np.intp)).shape == (0, 5)


def test_threads_do_not_change_the_actions(file):
    one, two = OnnxPolicy(file), OnnxPolicy(file, threads=2)
    one.reset(50)
    two.reset(50)
    assert (one.act(observed(50), np.arange(50)) == two.act(observed(50), np.arange(50))).all()


def test_running_a_policy_imports_neither_torch_nor_lerobot(file):
    code = ("import sys; from pathlib import Path; from pipeline.policies.onnx_policy import OnnxPolicy; "
            "OnnxPolicy(Path(sys.argv[1])); "
            "print(sorted({'torch', 'lerobot', 'mujoco', 'prefect'} & set(sys.modules)))")
    done = subprocess.run([sys.executable, "-c", code, file], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
