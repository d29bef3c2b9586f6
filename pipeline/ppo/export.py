"""ONNX export of a trained policy: its mean action, the normaliser folded into the first layer.

Input `observation` (n, w) is what a robot senses as it is, output `action` (n, j) is shares as LeggedWorld.act takes
them, not cut off. The same weights always give the same bytes.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from pipeline.errors import PolicyError
from pipeline.files import atomic
from pipeline.policies.export import IR, OPSET
from pipeline.ppo.normaliser import Normaliser
from pipeline.ppo.runner import OnnxRunner

type Weights = Mapping[str, NDArray[Any]]
"""SB3's names of an ActorCriticPolicy with an MLP -> values."""

PARITY_LIMIT = 1e-5
"""Largest difference to PyTorch, in shares."""


def layers(weights: Weights) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Matrix (out, in) and bias of each layer of the actor, the last one giving the mean action."""
    hidden = sorted({int(name.split(".")[2]) for name in weights if name.startswith("mlp_extractor.policy_net.")})
    names = [*(f"mlp_extractor.policy_net.{i}" for i in hidden), "action_net"]
    return [(weights[f"{n}.weight"].astype(np.float64), weights[f"{n}.bias"].astype(np.float64)) for n in names]


def build(weights: Weights, normaliser: Normaliser, facts: Mapping[str, str]) -> bytes:
    """The bytes of the ONNX file; `facts` become its metadata."""
    stack = layers(weights)
    first, bias = stack[0]
    stack[0] = first / normaliser.std, bias - first @ (normaliser.mean / normaliser.std)
    nodes: list[onnx.NodeProto] = []
    constants: dict[str, NDArray[np.float32]] = {}
    value = "observation"
    for i, (matrix, bias) in enumerate(stack):
        constants[f"weight{i}"] = np.ascontiguousarray(matrix.T, np.float32)
        constants[f"bias{i}"] = bias.astype(np.float32)
        last = i == len(stack) - 1
        out = "action" if last else f"linear{i}"
        nodes.append(helper.make_node("Gemm", [value, f"weight{i}", f"bias{i}"], [out], name=out))
        if not last:
            nodes.append(helper.make_node("Elu", [out], [value := f"elu{i}"], name=f"elu{i}"))
    sizes = ("observation", stack[0][0].shape[1]), ("action", stack[-1][0].shape[0])
    rows = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", size]) for name, size in sizes]
    initializers = [
        numpy_helper.from_array(values, name)  # pyright: ignore[reportUnknownMemberType]
        for name, values in sorted(constants.items())]
    model = helper.make_model(helper.make_graph(nodes, "actor", rows[:1], rows[1:], initializers),
                              producer_name="hardcase", opset_imports=[helper.make_opsetid("", OPSET)],
                              ir_version=IR)
    helper.set_model_props(model, dict(sorted(facts.items())))
    onnx.checker.check_model(model, full_check=True)  # pyright: ignore[reportUnknownMemberType]
    return model.SerializeToString(deterministic=True)


def write_policy(path: Path, model: bytes, observations: NDArray[np.float32],
                 expected: NDArray[np.float32]) -> float:
    """Write the file where it gives what PyTorch gives; return the largest difference.

    Args:
        path: where to.
        model: bytes of `build`.
        observations: rows to compare on, shape (k, w).
        expected: PyTorch's mean actions on them, shape (k, j).

    Raises:
        PolicyError: the difference is above 1e-5; nothing is left at `path`.
    """
    with atomic(path) as stream:
        stream.write(model)
        stream.flush()
        apart = float(np.abs(OnnxRunner.of(model).raw(observations) - expected).max())
        if not apart <= PARITY_LIMIT:  # also true for NaN
            raise PolicyError(f"ONNX differs from PyTorch by {apart:.1e}, above {PARITY_LIMIT:.0e}", where=path,
                              mend="train again: weights this large amplify rounding; lower learning_rate")
    return apart
