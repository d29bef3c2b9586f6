"""Evil and broken model files: each is refused in one error, and nothing in it ever runs."""

import pickle
import zipfile
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from safetensors.numpy import save_file

from pipeline.errors import PolicyError
from pipeline.policies.export import build
from pipeline.policies.onnx_policy import OnnxPolicy


@pytest.fixture
def model(fitted) -> onnx.ModelProto:
    return onnx.load_model_from_string(build(fitted))


def refused(path: Path) -> str:
    with pytest.raises(PolicyError) as caught:
        OnnxPolicy(path)
    assert str(path) in str(caught.value) and caught.value.mend
    return str(caught.value)


def written(path: Path, model: onnx.ModelProto) -> Path:
    path.write_bytes(model.SerializeToString())
    return path


class Evil:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


@pytest.mark.parametrize("name", ["policy.pt", "policy.onnx", "policy.pkl"])
@pytest.mark.parametrize("zipped", [False, True], ids=["bare pickle", "pickle in a zip, as torch writes it"])
def test_a_pickle_is_refused_and_never_runs(tmp_path, name, zipped):
    mark, path = tmp_path / "owned", tmp_path / name
    evil = pickle.dumps({"weights": Evil(mark)})
    if zipped:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("policy/data.pkl", evil)
    else:
        path.write_bytes(evil)
    assert "mend: pickle is never loaded; export safetensors or ONNX" in refused(path)
    assert not mark.exists()


def test_a_safetensors_file_is_told_apart(tmp_path):
    save_file({"a": np.zeros(3, np.float32)}, tmp_path / "model.safetensors")
    assert "mend: use the policy.onnx beside it" in refused(tmp_path / "model.safetensors")


@pytest.mark.parametrize("data", [b"", b"hello world", b"\xff" * 200], ids=["empty", "text", "noise"])
def test_what_is_no_model_is_refused(tmp_path, data):
    path = tmp_path / "policy.onnx"
    path.write_bytes(data)
    assert "mend: " in refused(path)


def test_a_missing_file_is_refused(tmp_path):
    assert "cannot be read: No such file or directory" in refused(tmp_path / "policy.onnx")


def test_half_a_file_is_refused(tmp_path, fitted):
    data, path = build(fitted), tmp_path / "policy.onnx"
    for size in range(1, len(data), len(data) // 25):
        path.write_bytes(data[:size])
        refused(path)


def test_a_custom_operator_domain_is_refused(tmp_path, model):
    model.opset_import.append(helper.make_opsetid("evil.ops", 1))
    model.graph.node[1].domain = "evil.ops"
    assert "domain 'evil.ops' is not allowed" in refused(written(tmp_path / "policy.onnx", model))


@pytest.mark.parametrize("op", ["If", "Loop", "Scan", "Identity", "FusedMatMul"])
def test_an_operator_off_the_list_is_refused(tmp_path, model, op):
    model.graph.node[1].op_type = op
    message = refused(written(tmp_path / "policy.onnx", model))
    assert f"operator {op!r} is not allowed" in message and "allowed are Add, Concat" in message


def test_a_function_of_the_files_own_is_refused(tmp_path, model):
    model.functions.append(helper.make_function("", "Tanh", ["x"], ["y"], [helper.make_node("Exp", ["x"], ["y"])],
                                                [helper.make_opsetid("", 20)]))
    assert "1 functions of its own" in refused(written(tmp_path / "policy.onnx", model))


@pytest.mark.parametrize("location", ["../secret", "/etc/passwd", "beside.bin"])
def test_data_in_another_file_is_never_read(tmp_path, model, location):
    (tmp_path / "beside.bin").write_bytes(bytes(1 << 16))
    constant = model.graph.initializer[0]
    constant.ClearField("raw_data")
    constant.data_location = TensorProto.EXTERNAL
    constant.external_data.add(key="location", value=location)
    assert "mend: save the model as one file" in refused(written(tmp_path / "policy.onnx", model))


def test_weights_that_are_not_finite_are_refused(tmp_path, model):
    constant = next(c for c in model.graph.initializer if c.name == "layers.0.bias")
    values = numpy_helper.to_array(constant).copy()
    values[3] = np.nan
    constant.CopyFrom(numpy_helper.from_array(values, constant.name))
    assert "mend: train again: the weights must be finite" in refused(written(tmp_path / "policy.onnx", model))


def test_the_shapes_of_another_robot_are_refused(tmp_path, model):
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_value = 18
    message = refused(written(tmp_path / "policy.onnx", model))
    assert "'state': (0, 18)" in message and "mend: train on a dataset version of this robot" in message


@pytest.mark.parametrize("axis", [0, 1], ids=["rows", "columns"])
def test_a_small_file_that_would_take_a_mountain_of_memory_is_refused(tmp_path, model, axis):
    last = model.graph.node.pop()
    name = last.input[0]
    for k in range(40):
        model.graph.node.append(helper.make_node("Concat", [name, name], [f"twice{k}"], axis=axis))
        name = f"twice{k}"
    model.graph.node.append(last)
    message = refused(written(tmp_path / "policy.onnx", model))
    assert "values an attempt are allowed" in message or "more rows than attempts" in message


def test_what_a_file_claims_of_its_own_results_is_not_believed(tmp_path, model):
    claimed = helper.make_tensor_value_info("twice", TensorProto.FLOAT, ["n", 1])
    model.graph.value_info.append(claimed)
    last = model.graph.node.pop()
    model.graph.node.append(helper.make_node("Concat", [last.input[0]] * 70_000, ["twice"], axis=1))
    last.input[0] = "twice"
    model.graph.node.append(last)
    assert "'twice'" in refused(written(tmp_path / "policy.onnx", model))


@pytest.mark.parametrize("value", [None, "nan", "1e9", "much"], ids=str)
def test_a_file_must_say_how_chunks_are_ensembled(tmp_path, model, value):
    helper.set_model_props(model, {"ensemble_decay": value} if value else {})
    assert "ensemble" in refused(written(tmp_path / "policy.onnx", model))
