import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ConfigError, PolicyError
from pipeline.files import sha256_file
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.protocols import Observation
from schemas.dataset import DatasetVersion
from stages.train import train

VERSION = DatasetVersion(id="0" * 16, digest="1" * 64, recipe="test", generation=2, path="versions/" + "0" * 16,
                         episodes=("2" * 16,), held_out=(), weights={"base": 1.0}, inputs=(), code="3" * 64, frames=1)


def test_a_training_leaves_a_policy_that_acts(tmp_path, reaching, small):
    record = train(VERSION, reaching, small, seed=5, store=tmp_path)
    folder = tmp_path / record.checkpoint
    assert record.files == {p.name: sha256_file(p) for p in folder.iterdir() if p.name != "hardcase.json"}
    assert {"config.json", "model.safetensors", "policy_preprocessor.json", "policy.onnx"} <= set(record.files)
    assert (record.dataset, record.seed, record.generation, record.steps) == (VERSION.id, 5, 2, small.steps)
    assert record.onnx_error < 1e-5
    assert record.train_loss[-1][1] < 0.7 * record.train_loss[0][1]
    policy = OnnxPolicy(folder / "policy.onnx")
    policy.reset(2)
    assert np.isfinite(policy.act(Observation(np.zeros((2, 16)), np.zeros((2, 7))), np.arange(2))).all()


def test_a_policy_that_is_there_is_not_trained_again(tmp_path, reaching, small):
    first = train(VERSION, reaching, small, seed=5, store=tmp_path)

    def never(*_: object) -> None:
        raise AssertionError("trained again")
    assert train(VERSION, reaching, small, seed=5, store=tmp_path, progress=never) == first


def test_version_config_and_seed_each_give_another_policy(tmp_path, reaching, small):
    short = small.model_copy(update={"steps": 15})
    other = VERSION.model_copy(update={"id": "f" * 16})
    ids = [train(*args, seed=seed, store=tmp_path).id for seed, args in (
        (0, (VERSION, reaching, short)), (1, (VERSION, reaching, short)), (0, (other, reaching, short)),
        (0, (VERSION, reaching, short.model_copy(update={"batch": 32}))))]
    assert len(set(ids)) == 4


def test_a_training_that_was_interrupted_ends_in_the_same_policy(tmp_path, reaching, small):
    def interrupt(step: int, *_: object) -> None:
        if step >= 80:
            raise KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt):
        train(VERSION, reaching, small, seed=5, store=tmp_path / "a", progress=interrupt)
    assert not [p for p in (tmp_path / "a" / "policies").iterdir() if not p.name.startswith(".")]
    steps: list[int] = []
    resumed = train(VERSION, reaching, small, seed=5, store=tmp_path / "a", progress=lambda s, *_: steps.append(s))
    assert steps[0] > 80
    assert resumed == train(VERSION, reaching, small, seed=5, store=tmp_path / "b")
    assert sorted(p.name for p in (tmp_path / "a" / "policies").iterdir()) == [resumed.id]


@pytest.mark.parametrize("harm", ["changed", "extra", "missing", "no record"])
def test_a_policy_that_was_tampered_with_is_refused(tmp_path, reaching, small, harm):
    record = train(VERSION, reaching, small, seed=5, store=tmp_path)
    folder: Path = tmp_path / record.checkpoint
    if harm == "changed":
        (folder / "model.safetensors").write_bytes((folder / "model.safetensors").read_bytes()[:-1] + b"x")
    elif harm == "extra":
        (folder / "extra.py").write_text("print()")
    elif harm == "missing":
        (folder / "policy.onnx").unlink()
    else:
        (folder / "hardcase.json").unlink()
    said = rf"(is not what was trained|missing or damaged)(.|\n)*mend: .*rm -r {folder}"
    with pytest.raises(PolicyError, match=said):
        train(VERSION, reaching, small, seed=5, store=tmp_path)


def test_an_unknown_kind_of_policy_is_refused_before_anything_is_written(tmp_path, reaching, small):
    with pytest.raises(ConfigError, match="use one of: act, chunked"):
        train(VERSION, reaching, small.model_copy(update={"policy": "nothing"}), seed=0, store=tmp_path)
    assert not list(tmp_path.iterdir())


def test_importing_the_stage_waits_for_no_torch():
    code = "import sys, stages.train; print(sorted({'torch', 'lerobot', 'onnx'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[2], capture_output=True, text=True,
                          check=True)
    assert done.stdout == "[]\n"
