"""ACT from one camera: learnt, checkpointed, exported, opened again by lerobot and by ONNX Runtime alone."""

import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

from pipeline.errors import ConfigError, PolicyError
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.policies.act_checkpoint import write_act
from pipeline.policies.act_export import build_act, export_act
from pipeline.policies.act_onnx import ActOnnx
from pipeline.policies.act_training import fit_act
from pipeline.policies.export import export_onnx
from pipeline.policies.network import tensor
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.protocols import Observation, SeeingPolicy
from schemas.recipe import TrainConfig

ROOT = Path(__file__).parents[2]
EDGE, CHUNK = 32, 3
CONFIG = TrainConfig(policy="act", chunk=CHUNK, width=32, depth=1, shrink=8, steps=80, batch=16, checkpoint_every=20,
                     learning_rate=2e-3)


def scene(xy: np.ndarray) -> np.ndarray:
    """A red square on grey, where x and y in [-1, 1] say, (n, EDGE, EDGE, 3)."""
    pictures = np.full((len(xy), EDGE, EDGE, 3), 120, np.uint8)
    at = np.rint(10 + 6 * xy).astype(int)
    for picture, (x, y) in zip(pictures, at, strict=True):
        picture[y:y + 8, x:x + 8] = (200, 30, 30)
    return pictures


@dataclass
class Squares:
    """Hands that move to where a square is seen; nothing else tells where that is."""

    cameras: tuple[str, ...] = ("close",)
    held_out_rows: np.ndarray = field(default_factory=lambda: np.arange(1000, 1060))

    @property
    def films(self):
        return {f"observation.images.{name}": (scene(np.zeros((1, 2))),) for name in self.cameras}

    def draw(self, rng, batch):
        return rng.integers(0, 1000, batch)

    def gather(self, rows, deltas, augment=None, rng=None, pictures="float"):
        xy = np.random.default_rng(4).uniform(-1, 1, (1060, 2))[rows]
        state, environment = np.zeros((len(rows), len(STATE))), np.zeros((len(rows), len(ENVIRONMENT)))
        state += np.random.default_rng(5).normal(0, 0.01, (1060, len(STATE)))[rows]
        environment[:, :2] = 0.1 * xy
        actions = np.zeros((len(rows), len(deltas["action"]), len(ACTION)))
        actions[..., :2] = 0.02 * xy[:, None]
        actions[..., 4] = 0.08 * (xy[:, None, 0] > 0)
        pad = np.zeros(actions.shape[:2], bool)
        pad[::3, -1] = True
        actions[pad] = 1e3
        seen = scene(xy) if augment is None else augment(scene(xy), rng)
        return {"observation.state": state.astype(np.float32), "action": actions.astype(np.float32),
                "observation.environment_state": environment.astype(np.float32), "action_is_pad": pad,
                "observation.images.close": np.ascontiguousarray(seen.transpose(0, 3, 1, 2))}


@pytest.fixture(scope="module")
def act():
    return fit_act(Squares(), CONFIG, seed=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, act):
    folder = tmp_path_factory.mktemp("act")
    write_act(folder, act, CONFIG)
    assert export_act(act, folder / "policy.onnx") < 1e-6, "metres and radians; 1e-5 would be refused"
    return folder


def seen(n: int, seed: int) -> Observation:
    rng = np.random.default_rng(seed)
    return Observation(rng.normal(0, 0.01, (n, len(STATE))), rng.normal(0, 0.1, (n, len(ENVIRONMENT))),
                       {"close": scene(rng.uniform(-1, 1, (n, 2)))})


def test_it_learns_what_only_the_picture_tells(act, folder):
    assert act.held_out_loss[-1][1] < 0.5 * act.held_out_loss[0][1]
    assert act.train_loss[-1][1] < 0.7 * act.train_loss[0][1], "shifted pictures are harder"
    left, right = (Observation(np.zeros((1, len(STATE))), np.zeros((1, len(ENVIRONMENT))),
                               {"close": scene(np.array([[x, 0.0]]))}) for x in (-0.8, 0.8))
    policy = ActOnnx(folder / "policy.onnx")
    assert policy.chunks(left)[0, 0, 0] < -0.004 < 0.004 < policy.chunks(right)[0, 0, 0]


def test_where_the_cube_is_is_a_hint_in_training_and_never_an_input(folder):
    policy, one = ActOnnx(folder / "policy.onnx"), seen(4, 1)
    other = Observation(one.state, one.environment + 1, one.pictures)
    assert (policy.chunks(one) == policy.chunks(other)).all()
    names = {path.name for path in folder.iterdir()}
    assert "model.safetensors" in names and b"environment" not in (folder / "config.json").read_bytes()


def test_a_training_that_is_cut_off_goes_on_to_the_same_bits(tmp_path, act):
    def kill(done, total, loss):
        if done == 50:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_act(Squares(), CONFIG, seed=3, checkpoints=tmp_path, progress=kill)
    (left,) = tmp_path.glob("step-*.safetensors")
    again = fit_act(Squares(), CONFIG, seed=3, resume_from=left)
    assert build_act(again) == build_act(act)
    assert (again.train_loss, again.held_out_loss) == (act.train_loss, act.held_out_loss)


def test_another_seed_is_another_policy_and_no_checkpoint_of_this_one(tmp_path):
    short = CONFIG.model_copy(update={"steps": 20})
    one = fit_act(Squares(), short, seed=1, checkpoints=tmp_path)
    other = fit_act(Squares(), short, seed=2)
    assert any((one.weights[name] != other.weights[name]).any() for name in one.weights)
    with pytest.raises(PolicyError, match="another training") as caught:
        fit_act(Squares(), short, seed=2, resume_from=next(tmp_path.iterdir()))
    assert "train again" in caught.value.mend


def test_lerobots_own_tools_load_the_checkpoint_and_act_as_the_onnx_file_does(folder):
    policy = ACTPolicy.from_pretrained(folder)
    assert policy.model.backbone.conv1.out_channels == 64, "a whole ResNet18, as lerobot builds it"
    before, after = make_pre_post_processors(policy.config, str(folder))
    ours = ActOnnx(folder / "policy.onnx")
    for attempt in range(2):  # the second time shows that reset() forgets
        policy.reset()
        ours.reset(3)
        for tick in range(5):
            now = seen(3, seed=10 * attempt + tick)
            pictures = tensor(now.pictures["close"].transpose(0, 3, 1, 2).astype(np.float32) / 255)
            batch = before({"observation.state": tensor(now.state).float(), "observation.images.close": pictures})
            action = after(policy.select_action(batch))
            assert np.abs(action.numpy() - ours.act(now, np.arange(3))).max() < 1e-6


def test_lerobots_training_goes_on_from_the_checkpoint(folder, act):
    policy = ACTPolicy.from_pretrained(folder)
    found, s = Squares().gather(np.arange(16), {"action": range(CHUNK)}), act.scales
    loss, _ = policy.forward({
        "observation.images.close": tensor((found["observation.images.close"].transpose(0, 2, 3, 1) - s.pixel_mean)
                                           / s.pixel_std).permute(0, 3, 1, 2),
        "observation.state": tensor((found["observation.state"] - s.state_mean) / s.state_std),
        "action": tensor((found["action"] - s.action_mean) / s.action_std),
        "action_is_pad": tensor(found["action_is_pad"])})
    loss.backward()
    assert loss.item() < 0.5 and torch.isfinite(policy.model.backbone.conv1.weight.grad).all()


def test_it_is_deployed_without_torch_or_lerobot(folder):
    words = f"""
import sys, pathlib, numpy as np
from pipeline.policies.table import policy_kind
from pipeline.protocols import Observation
policy = policy_kind("act").open(pathlib.Path({str(folder / 'policy.onnx')!r}))
policy.reset(1)
policy.act(Observation(np.zeros((1, 16)), np.zeros((1, 7)), {{"close": np.zeros((1, {EDGE}, {EDGE}, 3), np.uint8)}}),
           np.arange(1))
assert not {{"torch", "lerobot"}} & sys.modules.keys(), "the robot needs neither"
"""
    done = subprocess.run([sys.executable, "-c", words], cwd=ROOT, timeout=300)
    assert done.returncode == 0


def test_an_attempt_acts_alike_in_any_company_and_from_any_memory(folder):
    policy, now, later = ActOnnx(folder / "policy.onnx"), seen(21, 3), seen(21, 4)
    assert isinstance(policy, SeeingPolicy) and policy.cameras == {"close": (EDGE, EDGE)}
    policy.reset(21)
    together = policy.act(now, np.arange(21))
    kept = policy.memory(np.array([20]))
    then = policy.act(later, np.arange(21))
    policy.reset(1)
    alone = policy.act(row(now, 20), np.arange(1))
    assert (alone == together[20:]).all()
    policy.reset(1)
    policy.restore(np.arange(1), kept)
    assert (policy.act(row(later, 20), np.arange(1)) == then[20:]).all()


def row(observation: Observation, k: int) -> Observation:
    return Observation(observation.state[k:k + 1], observation.environment[k:k + 1],
                       {name: p[k:k + 1] for name, p in observation.pictures.items()})


@pytest.mark.parametrize(("pictures", "says"), [
    ({}, "sees nothing through camera 'close'"), ({"close": np.zeros((1, 16, 16, 3), np.uint8)}, r"\(1, 16, 16, 3\)")],
    ids=["blind", "another size"])
def test_it_does_not_act_without_the_pictures_it_needs(folder, pictures, says):
    policy = ActOnnx(folder / "policy.onnx")
    policy.reset(1)
    with pytest.raises(PolicyError, match=says) as caught:
        policy.act(Observation(np.zeros((1, len(STATE))), np.zeros((1, len(ENVIRONMENT))), pictures), np.arange(1))
    assert "camera" in caught.value.mend


def test_files_of_one_kind_are_refused_as_the_other(tmp_path, folder, fitted):
    export_onnx(fitted, tmp_path / "chunked.onnx")
    with pytest.raises(PolicyError, match="pictures of sizes None") as caught:
        ActOnnx(tmp_path / "chunked.onnx")
    assert "pictures of one camera" in caught.value.mend
    with pytest.raises(PolicyError, match="a policy that sees, and nothing here shows it pictures") as caught:
        OnnxPolicy(folder / "policy.onnx")
    assert "hardcase gate, exam, deploy" in caught.value.mend


@pytest.mark.parametrize("cameras", [(), ("close", "top")], ids=["none", "two"])
def test_a_version_without_one_camera_is_refused(cameras):
    with pytest.raises(ConfigError, match=f"ACT takes one camera, the version has {len(cameras)}") as caught:
        fit_act(Squares(cameras), CONFIG, seed=0)
    assert "dataset.cameras.close: {width: 96, height: 96}" in caught.value.mend


def test_a_checkpoint_is_never_overwritten(folder, act):
    with pytest.raises(PolicyError, match=r"already(.|\n)*mend: write to another folder"):
        write_act(folder, act, CONFIG)
