"""ONNX export: the trained network as a small graph written by hand, normalisation folded into its weights.

Inputs `state` (n, 16) and `environment` (n, 7) are observations as they are, output `chunk` (n, chunk, 5)
is in the units of pipeline.frames.ACTION. Written node by node because PyTorch's exporter takes seconds
and puts names of its own version in the file; the same weights always give the same bytes.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from pipeline.errors import PolicyError
from pipeline.files import atomic
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.policies.ensembling import DECAY
from pipeline.policies.features import FEATURES, WIDTHS, matrix
from pipeline.policies.network import array, tensor
from pipeline.policies.runtime import Session
from pipeline.policies.training import Fitted

type F32 = NDArray[np.float32]

OPSET, IR = 20, 9
"""Opset 20 is the first with Gelu; IR 9 is the version that came with it."""
PARITY_ROWS, PARITY_LIMIT = 512, 1e-5


@dataclass(frozen=True, slots=True)
class _Graph:
    """Nodes and constants under construction."""

    nodes: list[onnx.NodeProto]
    constants: dict[str, NDArray[np.float32 | np.int64]]

    def add(self, op: str, inputs: tuple[str, ...], *outputs: str, **attributes: Any) -> None:
        """Append a node, named by its first output."""
        self.nodes.append(helper.make_node(op, list(inputs), list(outputs), name=outputs[0], **attributes))


def _features(graph: _Graph) -> None:
    graph.constants.update({"matrix": matrix(), "widths": np.array(WIDTHS, np.int64)})
    graph.add("Concat", ("state", "environment"), "observed", axis=1)
    graph.add("MatMul", ("observed", "matrix"), "differences")
    graph.add("Split", ("differences", "widths"), *(f"{shape}_in" for shape in FEATURES), axis=1)
    shaped = ["linear_in"]
    for shape in list(FEATURES)[1:]:
        graph.add(shape.capitalize(), (f"{shape}_in",), shape)
        shaped.append(shape)
    graph.add("Concat", tuple(shaped), "features", axis=1)


def _folded(fitted: Fitted) -> dict[str, F32]:
    """Weights whose first layer takes features as they are and whose last gives actions in their units."""
    w = {name: values.astype(np.float64) for name, values in fitted.weights.items()}
    last, repeat = 3 * fitted.shape.depth, fitted.shape.chunk
    mean, std = (np.tile(v.astype(np.float64), repeat) for v in (fitted.action_mean, fitted.action_std))
    w["layers.0.bias"] = w["layers.0.bias"] - w["layers.0.weight"] @ (w["feature_mean"] / w["feature_std"])
    w["layers.0.weight"] = w["layers.0.weight"] / w["feature_std"]
    w[f"layers.{last}.bias"] = w[f"layers.{last}.bias"] * std + mean
    w[f"layers.{last}.weight"] = w[f"layers.{last}.weight"] * std[:, None]
    return {name: np.ascontiguousarray(v.T if v.ndim == 2 else v, np.float32)
            for name, v in w.items() if name.startswith("layers.")}


def build(fitted: Fitted) -> bytes:
    """The bytes of the ONNX file."""
    graph, shape = _Graph([], {}), fitted.shape
    _features(graph)
    graph.constants.update({**_folded(fitted), "form": np.array([-1, shape.chunk, len(ACTION)], np.int64)})
    value = "features"
    for i in range(0, 3 * shape.depth, 3):
        graph.add("Gemm", (value, f"layers.{i}.weight", f"layers.{i}.bias"), f"linear{i}")
        graph.add("LayerNormalization", (f"linear{i}", f"layers.{i + 1}.weight", f"layers.{i + 1}.bias"), f"norm{i}",
                  axis=-1, epsilon=1e-5)
        graph.add("Gelu", (f"norm{i}",), value := f"gelu{i}")
    last = 3 * shape.depth
    graph.add("Gemm", (value, f"layers.{last}.weight", f"layers.{last}.bias"), "flat")
    graph.add("Reshape", ("flat", "form"), "chunk")
    rows = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", *sizes]) for name, sizes in (
        ("state", [len(STATE)]), ("environment", [len(ENVIRONMENT)]), ("chunk", [shape.chunk, len(ACTION)]))]
    initializers = [
        numpy_helper.from_array(values, name)  # pyright: ignore[reportUnknownMemberType]
        for name, values in sorted(graph.constants.items())]
    model = helper.make_model(
        helper.make_graph(graph.nodes, "chunked", rows[:2], rows[2:], initializers), producer_name="hardcase",
        opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
    helper.set_model_props(model, {"ensemble_decay": repr(DECAY)})
    onnx.checker.check_model(model, full_check=True)  # pyright: ignore[reportUnknownMemberType]
    return model.SerializeToString(deterministic=True)


def parity(fitted: Fitted, model: bytes) -> float:
    """Largest |PyTorch - ONNX Runtime| over a batch of random observations, in action units."""
    rng = np.random.default_rng(0)
    state = rng.normal(0, 0.3, (PARITY_ROWS, len(STATE))).astype(np.float32)
    environment = rng.normal(0, 0.3, (PARITY_ROWS, len(ENVIRONMENT))).astype(np.float32)
    with torch.no_grad():
        expected = array(fitted.network()(tensor(state), tensor(environment))) * fitted.action_std + fitted.action_mean
    got = Session(model).run(state, environment)
    return float(np.abs(got - expected).max())


def export_onnx(fitted: Fitted, path: Path) -> float:
    """Write the ONNX file; return the largest difference to PyTorch in action units.

    Raises:
        PolicyError: the difference is above 1e-5.
    """
    model = build(fitted)
    return write_within(path, model, parity(fitted, model))


def write_within(path: Path, model: bytes, error: float) -> float:
    """Write a model whose difference to PyTorch is known; returns that difference.

    Raises:
        PolicyError: the difference is above 1e-5.
    """
    if not error <= PARITY_LIMIT:  # also true for NaN
        raise PolicyError(f"ONNX differs from PyTorch by {error:.1e}, above {PARITY_LIMIT:.0e}", where=path,
                          mend="train again: weights this large amplify rounding; lower train.learning_rate")
    with atomic(path) as stream:
        stream.write(model)
    return error
