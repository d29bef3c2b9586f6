import dataclasses

import numpy as np
import onnx
import pytest

from pipeline.errors import PolicyError
from pipeline.policies.export import build, export_onnx, parity
from pipeline.policies.training import fit


@pytest.mark.parametrize("depth", [1, 3])
def test_onnx_equals_pytorch_for_every_depth(tmp_path, reaching, small, depth):
    fitted = fit(reaching, small.model_copy(update={"depth": depth, "steps": 40}), 0)
    assert export_onnx(fitted, tmp_path / "policy.onnx") < 1e-5


def test_the_same_weights_give_the_same_file(fitted):
    assert build(fitted) == build(fitted)


def test_the_file_takes_raw_observations_and_gives_actions(fitted, small):
    graph = onnx.load_model_from_string(build(fitted)).graph
    shapes = {v.name: [d.dim_param or d.dim_value for d in v.type.tensor_type.shape.dim]
              for v in (*graph.input, *graph.output)}
    assert shapes == {"state": ["n", 16], "environment": ["n", 7], "chunk": ["n", small.chunk, 5]}


def test_a_file_that_differs_from_pytorch_is_not_written(tmp_path, fitted):
    last = f"layers.{3 * fitted.shape.depth}.weight"
    huge = dataclasses.replace(fitted, weights={**fitted.weights, last: fitted.weights[last] * np.float32(1e4)})
    assert parity(huge, build(huge)) > 1e-5
    with pytest.raises(PolicyError, match=r"differs from PyTorch(.|\n)*mend: train again"):
        export_onnx(huge, tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())
