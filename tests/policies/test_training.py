import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.errors import PolicyError
from pipeline.policies.network import array, tensor
from pipeline.policies.resuming import newest
from pipeline.policies.training import Fitted, fit

ROOT = Path(__file__).parents[2]


def as_bytes(fitted: Fitted) -> dict[str, bytes]:
    return {name: values.tobytes() for name, values in fitted.weights.items()}


def test_a_policy_learns_both_groups_of_places(reaching, small):
    fitted = fit(reaching, small.model_copy(update={"steps": 400}), seed=0)
    first, last = fitted.train_loss[0][1], fitted.train_loss[-1][1]
    assert last < first / 5
    assert fitted.held_out_loss[-1][1] < fitted.held_out_loss[0][1] / 4
    for centre in (0.2, 0.9):
        state, environment, actions, mask = reaching.batch(np.random.default_rng(5), {centre: 500}, small.chunk)
        with torch.no_grad():
            chunk = array(fitted.network()(tensor(state), tensor(environment)))
        error = np.abs(chunk * fitted.action_std + fitted.action_mean - actions)[mask]
        assert error[:, :3].mean() < 0.004  # [m], of steps up to 0.02


def test_training_is_strict_about_determinism_and_leaves_pytorch_as_it_was(reaching, small):
    seen = set[int]()
    fit(reaching, small.model_copy(update={"steps": 20}), seed=0,
        progress=lambda *_: seen.add(torch.get_deterministic_debug_mode()))
    assert seen == {2}, "2 refuses what could differ from run to run"
    assert torch.get_deterministic_debug_mode() == 0


def test_training_leaves_the_compiler_of_pytorch_alone():
    code = """
import sys
import numpy as np
from pipeline.policies.training import fit
from schemas.recipe import TrainConfig

class Data:
    def sample(self, rng, n, chunk):
        draw = lambda *shape: rng.normal(size=shape).astype(np.float32)
        return draw(n, 16), draw(n, 7), draw(n, chunk, 5), np.ones((n, chunk), bool)
    def held_out(self, chunk):
        return self.sample(np.random.default_rng(0), 50, chunk)

fit(Data(), TrainConfig(steps=20, width=16, batch=32), 0)
print(sorted({"torch._inductor", "torch._dynamo", "triton", "lerobot"} & set(sys.modules)))
"""
    told = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, text=True, capture_output=True).stdout
    assert told.strip() == "[]", "importing it costs a second and 110 MB"


def test_padding_is_never_learnt(fitted):
    assert np.abs(fitted.action_mean).max() < 0.1  # padded rows hold 1000
    assert fitted.train_loss[-1][1] < 0.3


def test_the_seed_decides_the_bytes(reaching, small, fitted):
    assert as_bytes(fit(reaching, small, seed=3)) == as_bytes(fitted)
    assert as_bytes(fit(reaching, small, seed=4)) != as_bytes(fitted)


def test_training_leaves_pytorch_as_it_was(reaching, small):
    torch.manual_seed(0)
    expected = torch.rand(3)
    torch.manual_seed(0)
    before = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    fit(reaching, small.model_copy(update={"steps": 20}), seed=0, threads=2)
    assert (torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()) == before
    assert (torch.rand(3) == expected).all()


KILLED = """
import os, signal, sys, threading
from pathlib import Path
from runpy import run_path
world = run_path(sys.argv[1])
from pipeline.policies.training import fit
timer = threading.Timer(float(sys.argv[3]), os.kill, (os.getpid(), signal.SIGKILL))
fit(world["Reaching"](), world["SMALL"].model_copy(update={"steps": 100_000, "checkpoint_every": 7}), 3,
    checkpoints=Path(sys.argv[2]), progress=lambda *_: timer.ident or timer.start())
"""


@pytest.mark.parametrize("moment", range(2))
def test_a_training_killed_at_any_moment_resumes_to_the_same_bytes(tmp_path, reaching, small, moment):
    here, delay = Path(__file__).with_name("conftest.py"), np.random.default_rng(moment).uniform(0, 0.3)
    killed = subprocess.run([sys.executable, "-c", KILLED, here, tmp_path, str(delay)], cwd=ROOT, check=False,
                            env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert killed.returncode == -signal.SIGKILL
    saved = newest(tmp_path)
    assert saved is not None
    long = small.model_copy(update={"steps": 100_000, "checkpoint_every": 7})
    stop = int(saved.stem.removeprefix("step-")) + 25

    def halt(step: int, *_: object) -> None:
        if step >= stop:
            raise KeyboardInterrupt
    for folder, start in ((tmp_path / "resumed", saved), (tmp_path / "whole", None)):
        with pytest.raises(KeyboardInterrupt):
            fit(reaching, long, 3, resume_from=start, checkpoints=folder, progress=halt)
    resumed, whole = (newest(tmp_path / name) for name in ("resumed", "whole"))
    assert resumed is not None and whole is not None and resumed.name == whole.name
    assert resumed.read_bytes() == whole.read_bytes()


def test_an_interrupt_between_blocks_and_checkpoints_resumes_to_the_same_bytes(tmp_path, reaching, small):
    odd = small.model_copy(update={"checkpoint_every": 33, "steps": 77})

    def interrupt(step: int, *_: object) -> None:
        if step >= 70:
            raise KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt):
        fit(reaching, odd, 1, checkpoints=tmp_path, progress=interrupt)
    assert [p.name for p in tmp_path.iterdir()] == ["step-0000066.safetensors"]
    resumed = fit(reaching, odd, 1, resume_from=newest(tmp_path))
    whole = fit(reaching, odd, 1)
    assert as_bytes(resumed) == as_bytes(whole)
    assert resumed.train_loss == whole.train_loss


def test_a_checkpoint_of_another_training_is_refused(tmp_path, reaching, small):
    fit(reaching, small, 3, checkpoints=tmp_path)
    for seed, config in ((4, small), (3, small.model_copy(update={"width": 16}))):
        with pytest.raises(PolicyError, match=r"another training.*\n.*\n.*mend: delete it and train again"):
            fit(reaching, config, seed, resume_from=newest(tmp_path))


def test_a_damaged_checkpoint_is_refused(tmp_path, reaching, small):
    fit(reaching, small, 3, checkpoints=tmp_path)
    path = newest(tmp_path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(PolicyError, match=r"not a training checkpoint[^\n]*\n.*\n.*mend: delete it and train again"):
        fit(reaching, small, 3, resume_from=path)


def test_a_training_that_diverges_says_so(reaching, small):
    with pytest.raises(PolicyError, match=r"diverged(.|\n)*mend: lower train.learning_rate"):
        fit(reaching, small.model_copy(update={"learning_rate": 1e30}), 0)


def test_samples_of_another_robot_are_refused(reaching, small):
    class OtherRobot(type(reaching)):
        def sample(self, rng, batch, chunk):
            state, *rest = super().sample(rng, batch, chunk)
            return state[:, :15], *rest
    with pytest.raises(PolicyError, match=r"\(15,\), the robot has \(16,\)(.|\n)*mend: .*hardcase build"):
        fit(OtherRobot(), small, 0)
