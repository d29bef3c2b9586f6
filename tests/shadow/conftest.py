"""Policies made by hand, good ones and bad ones, and a robot at work with candidates in its champion's shadow."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.recording import read_episode
from pipeline.shadow.limits import Limits
from pipeline.shadow.riders import Riders
from schemas.recipe import DeployConfig, Recipe
from stages.deploy import deploy

CHUNK, WIDE = 4, 256


class Model:
    """A small network, node by node; `last` is its newest result."""

    def __init__(self) -> None:
        self.nodes, self.constants, self.last = [], [], "state"

    def constant(self, values: np.ndarray) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(values, name))
        return name

    def then(self, kind: str, *inputs: str) -> str:
        self.last = f"r{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [self.last]))
        return self.last

    def write(self, path: Path) -> Path:
        """Save it with its newest result as the chunk."""
        self.nodes[-1].output[0] = "chunk"
        inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", len(columns)])
                  for name, columns in (("state", STATE), ("environment", ENVIRONMENT))]
        chunk = helper.make_tensor_value_info("chunk", TensorProto.FLOAT, ["n", CHUNK, len(ACTION)])
        model = helper.make_model(helper.make_graph(self.nodes, "policy", inputs, [chunk], self.constants),
                                  opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
        helper.set_model_props(model, {"ensemble_decay": "0.3"})
        onnx.save_model(model, path)
        return path

    def chunk(self, seed: int = 0) -> str:
        """Small motions that follow from the state."""
        draw = np.random.default_rng(seed)
        weights = self.constant(draw.normal(0, 0.004, (len(STATE), CHUNK * len(ACTION))).astype(np.float32))
        moved = self.then("MatMul", "state", weights)
        return self.then("Reshape", moved, self.constant(np.array([0, CHUNK, len(ACTION)])))


def _good(model: Model, seed: int = 0) -> None:
    model.chunk(seed)


def _nan(model: Model) -> None:
    chunk = model.chunk()
    nothing = model.then("Sub", chunk, chunk)
    model.then("Div", nothing, nothing)


def _hog(model: Model) -> None:
    """4 MiB an attempt, and not a byte of it in the file."""
    chunk = model.chunk()
    tall = model.then("Reshape", "state", model.constant(np.array([0, len(STATE), 1, 1])))
    tall = model.then("Add", tall, model.constant(np.zeros((1, 1, WIDE, 1), np.float32)))
    wide = model.then("Add", tall, model.constant(np.zeros((1, 1, 1, WIDE), np.float32)))
    ends, axes = model.constant(np.array([1, 1, 1])), model.constant(np.array([1, 2, 3]))
    one = model.then("Slice", wide, model.constant(np.array([0, 0, 0])), ends, axes)
    one = model.then("Reshape", one, model.constant(np.array([0, 1, 1])))
    model.then("Add", chunk, one)


def _busy(model: Model) -> None:
    """Half a second of arithmetic for a few attempts."""
    chunk, draw = model.chunk(), np.random.default_rng(2)
    wide = model.then("MatMul", "state", model.constant(draw.normal(0, 1, (len(STATE), 1024)).astype(np.float32)))
    weights = model.constant(draw.normal(0, 1024**-0.5, (1024, 1024)).astype(np.float32))
    for _ in range(900):
        wide = model.then("MatMul", wide, weights)
    nothing = model.then("MatMul", wide, model.constant(np.zeros((1024, CHUNK * len(ACTION)), np.float32)))
    nothing = model.then("Reshape", nothing, model.constant(np.array([0, CHUNK, len(ACTION)])))
    model.then("Add", chunk, nothing)


KINDS: Mapping[str, Callable[[Model], None]] = {"good": _good, "other": lambda m: _good(m, 1), "nan": _nan, "hog": _hog,
                                                 "busy": _busy}


@pytest.fixture(scope="session")
def files(tmp_path_factory) -> Mapping[str, Path]:
    """Name -> policy file: two that are right, others that say NaN or are greedy, and one that is no model."""
    folder = tmp_path_factory.mktemp("policies")
    made = {}
    for kind, build in KINDS.items():
        model = Model()
        build(model)
        made[kind] = model.write(folder / f"{kind}.onnx")
    made["hostile"] = folder / "hostile.onnx"
    made["hostile"].write_bytes(b"\x80\x04\x95\x1b\x00\x00\x00cos\nsystem\n")
    return made


RECIPE = Recipe(name="tests", deploy=DeployConfig(episodes=20, rare_share=0.1))


@pytest.fixture(scope="session")
def work(files, interrupted, tmp_path_factory) -> Callable[..., SimpleNamespace]:
    """Lets the champion work in simulation; `happens` is called with the candidates' process ids at tick `at`."""

    def working(candidates: Mapping[str, Path], limits: Limits | None = None, *, at: int = -1,
                happens: Callable[[Mapping[str, int]], None] = lambda pids: None) -> SimpleNamespace:
        champion = interrupted(OnnxPolicy)(files["good"])
        with Riders(candidates, limits, patient=True) as riders:
            champion.at, champion.happens = at, lambda: happens(riders.pids())
            done = deploy(champion, "c" * 16, RECIPE, seed=3, twin=4, generation=0, software={},
                          folder=tmp_path_factory.mktemp("deployed"), riders=riders)
        return SimpleNamespace(states=done.shadows, attempts=[read_episode(r.path) for r in done.recorded],
                               files=[r.path for r in done.recorded])

    return working


@pytest.fixture(scope="session")
def alone(work) -> SimpleNamespace:
    """The champion with nobody in its shadow."""
    return work({})


@pytest.fixture(scope="session")
def commands() -> Callable[[SimpleNamespace], list[dict[str, bytes]]]:
    """The bytes of all that the champion saw, said and was left with, attempt by attempt."""
    names = ("state", "environment", "action", "joint_action", "sim_state", "controller")

    def of(done: SimpleNamespace) -> list[dict[str, bytes]]:
        return [{name: getattr(trace, name).tobytes() for name in names} for _, trace in done.attempts]

    return of
