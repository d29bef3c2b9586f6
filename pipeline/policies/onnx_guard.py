"""What an ONNX file must be before it is loaded: known operators, no outside data, the robot's shapes.

A model file is somebody's input. Nothing here runs the model; only a file that passes is handed to
ONNX Runtime, as the very bytes that were checked.
"""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from google.protobuf.message import DecodeError
from numpy.typing import NDArray
from onnx import numpy_helper, shape_inference

from pipeline.errors import PolicyError
from pipeline.frames import ACTION, ENVIRONMENT, STATE

OPERATORS = frozenset({"Add", "Concat", "Conv", "Cos", "Div", "Elu", "Gelu", "Gemm", "LayerNormalization", "MatMul",
                       "MaxPool", "Mul", "Relu", "Reshape", "Sin", "Slice", "Softmax", "Split", "Sub", "Tanh",
                       "Transpose"})
"""All of them arithmetic on tensors: none reads files, loops, branches or holds a graph of its own."""

MAX_BYTES, MAX_NODES, MAX_VALUES = 64 << 20, 1000, 1 << 20
"""Limits of the file, of the graph, and of the values an attempt may take in any intermediate result."""

MAX_CHUNK = 1024
MAX_EDGE = 512
"""Of a picture [px]."""

untyped: Any = numpy_helper
"""Its arrays have no element types."""

EXPORT = "export the policy again: hardcase train"
PICKLE = "pickle is never loaded; export safetensors or ONNX"
PICKLE_STARTS = (b"PK\x03\x04", b"PK\x05\x06", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05", b"(lp", b"(dp",
                 b"\x93NUMPY")
"""Zip (torch.save, joblib, npz), pickle protocols 2 to 5 and 0, and npy, which may hold a pickle."""
PICKLE_NAMES = frozenset({".pt", ".pth", ".pkl", ".pickle", ".joblib", ".ckpt", ".bin", ".npy", ".npz"})


def checked_model(path: Path) -> tuple[bytes, int, dict[str, str]]:
    """Read an ONNX file and refuse it unless it is a policy of ours in everything that could do harm.

    Returns:
        The bytes to load, the length of its chunks, and its metadata.

    Raises:
        PolicyError: what is wrong with the file, and the mend.
    """
    data, model = _checked(path)
    _check_inputs(model, {"state": (0, len(STATE)), "environment": (0, len(ENVIRONMENT))}, path)
    return data, _check_shapes(model, path), _told(model)


def checked_seeing_model(path: Path) -> tuple[bytes, int, dict[str, str], tuple[int, int]]:
    """The same for a policy that sees: its inputs are the robot's own state and pictures of one camera.

    Returns:
        What checked_model returns, and height and width of the pictures [px].

    Raises:
        PolicyError: what is wrong with the file, and the mend.
    """
    data, model = _checked(path)
    seen = next((_sizes(value) for value in model.graph.input if value.name == "pictures"), None)
    height, width = seen[2:] if seen is not None and len(seen) == 4 else (0, 0)
    if not (1 <= height <= MAX_EDGE and 1 <= width <= MAX_EDGE):
        raise PolicyError(f"pictures of sizes {seen}", where=path,
                          mend=f"train on pictures of one camera, at most {MAX_EDGE}x{MAX_EDGE}")
    _check_inputs(model, {"state": (0, len(STATE)), "pictures": (0, 3, height, width)}, path)
    return data, _check_shapes(model, path), _told(model), (height, width)


def checked_plain_model(path: Path) -> tuple[bytes, int, int, dict[str, str]]:
    """The same for a policy without memory: `observation` (n, w) to `action` (n, j).

    Returns:
        The bytes to load, w, j, and its metadata.

    Raises:
        PolicyError: what is wrong with the file, and the mend.
    """
    data, model = _checked(path)
    found = [{value.name: _sizes(value) for value in values} for values in (model.graph.input, model.graph.output)]
    sizes = [kinds.get(name) for kinds, name in zip(found, ("observation", "action"), strict=True)]
    (w, j) = (s[1] if s is not None and len(s) == 2 and s[0] == 0 else 0 for s in sizes)
    if [len(kinds) for kinds in found] != [1, 1] or not w or not j:
        raise PolicyError(f"inputs and outputs {found}, expected are 'observation' (0, w) and 'action' (0, j)",
                          where=path, mend="use a policy.onnx that hardcase rl train has left")
    _check_results(model, path)
    return data, w, j, _told(model)


def _checked(path: Path) -> tuple[bytes, onnx.ModelProto]:
    data = _read(path)
    try:
        model = onnx.load_model_from_string(data)
    except DecodeError as error:
        raise PolicyError("not an ONNX file", where=path, mend=EXPORT) from error
    _check_operators(model, path)
    _check_constants(model, path)
    return data, model


def _told(model: onnx.ModelProto) -> dict[str, str]:
    return {entry.key: entry.value for entry in model.metadata_props}


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise PolicyError(f"policy file cannot be read: {error.strerror}", where=path, mend=EXPORT) from error
    if path.suffix.lower() in PICKLE_NAMES or data.startswith(PICKLE_STARTS):
        raise PolicyError("pickle where a model is expected", where=path, mend=PICKLE)
    if len(data) > MAX_BYTES:
        raise PolicyError(f"larger than {MAX_BYTES} B", where=path, mend=EXPORT)
    if data[8:9] == b"{" and int.from_bytes(data[:8], "little") < len(data):
        raise PolicyError("a safetensors file where an ONNX file is expected", where=path,
                          mend="use the policy.onnx beside it")
    return data


def _check_operators(model: onnx.ModelProto, path: Path) -> None:
    domains = {opset.domain for opset in model.opset_import} | {node.domain for node in model.graph.node}
    if foreign := domains - {"", "ai.onnx"}:
        raise PolicyError(f"operator domain {min(foreign)!r} is not allowed", where=path, mend=EXPORT)
    if unknown := {node.op_type for node in model.graph.node} - OPERATORS:
        raise PolicyError(f"operator {min(unknown)!r} is not allowed", where=path,
                          mend=f"{EXPORT}; allowed are {', '.join(sorted(OPERATORS))}")
    if len(model.graph.node) > MAX_NODES or model.functions or model.training_info:
        raise PolicyError(f"{len(model.graph.node)} nodes, {len(model.functions)} functions of its own", where=path,
                          mend=f"{EXPORT}; at most {MAX_NODES} nodes and no functions are allowed")


def _check_constants(model: onnx.ModelProto, path: Path) -> None:
    attributes = [a for node in model.graph.node for a in node.attribute]
    if model.graph.sparse_initializer or any(a.HasField("t") or a.tensors or a.HasField("sparse_tensor")
                                             or a.HasField("g") or a.graphs for a in attributes):
        raise PolicyError("constants outside the list of initializers", where=path, mend=EXPORT)
    for constant in model.graph.initializer:
        if constant.external_data or constant.data_location != onnx.TensorProto.DEFAULT:
            raise PolicyError(f"constant {constant.name!r} lies in another file", where=path,
                              mend="save the model as one file; data outside it is never read")
        try:
            values: NDArray[Any] = untyped.to_array(constant)
        except (ValueError, TypeError) as error:
            raise PolicyError(f"constant {constant.name!r} is damaged", where=path, mend=EXPORT) from error
        if values.dtype.name not in ("float32", "int64") or not np.isfinite(values).all():
            raise PolicyError(f"constant {constant.name!r} is {values.dtype} or not finite", where=path,
                              mend="train again: the weights must be finite float32")


def _sizes(value: onnx.ValueInfoProto) -> tuple[int, ...] | None:
    """Sizes of a float32 tensor, 0 where not fixed; None for anything else."""
    kind = value.type.tensor_type
    if kind.elem_type != onnx.TensorProto.FLOAT or not kind.HasField("shape"):
        return None
    return tuple(d.dim_value if d.HasField("dim_value") else 0 for d in kind.shape.dim)


def _check_inputs(model: onnx.ModelProto, expected: dict[str, tuple[int, ...]], path: Path) -> None:
    inputs = {value.name: _sizes(value) for value in model.graph.input}
    if "pictures" in inputs and "pictures" not in expected:
        raise PolicyError("a policy that sees, and nothing here shows it pictures", where=path,
                          mend="let the stages drive it, which render for it (hardcase gate, exam, deploy), or use a "
                               "policy of kind chunked")
    if inputs != expected:
        raise PolicyError(f"inputs {inputs}, the robot gives {expected} (0: any number of attempts)", where=path,
                          mend="train on a dataset version of this robot")


def _check_shapes(model: onnx.ModelProto, path: Path) -> int:
    """Check the output and every intermediate result; return the length of the chunks."""
    outputs = {value.name: _sizes(value) for value in model.graph.output}
    out = outputs.get("chunk")
    if len(outputs) != 1 or out is None or len(out) != 3 or out[0] != 0 or out[2] != len(ACTION) \
            or not 1 <= out[1] <= MAX_CHUNK:
        raise PolicyError(f"outputs {outputs}, the robot takes 'chunk' (0, chunk, {len(ACTION)})", where=path,
                          mend="train on a dataset version of this robot")
    _check_results(model, path)
    return out[1]


def _check_results(model: onnx.ModelProto, path: Path) -> None:
    """Every intermediate result has known sizes, grows with the number of attempts only, and is small."""
    rows = {value.type.tensor_type.shape.dim[0].dim_param for value in model.graph.input}
    del model.graph.value_info[:]  # what a file claims of its own results proves nothing
    try:
        inferred = shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True).graph
    except Exception as error:  # onnx raises its own types from C++, none of them public
        raise PolicyError("shapes do not fit together", where=path, mend=EXPORT) from error
    results = {value.name: value for value in (*inferred.value_info, *inferred.output)}
    for node in model.graph.node:
        for name in node.output:
            value = results.get(name)
            sizes = None if value is None else _sizes(value)
            if value is None or not sizes or 0 in sizes[1:] or np.prod([max(1.0, size) for size in sizes]) > MAX_VALUES:
                raise PolicyError(f"intermediate result {name!r} of sizes {sizes}", where=path,
                                  mend=f"{EXPORT}; at most {MAX_VALUES} float32 values an attempt are allowed")
            kept = node.op_type == "Reshape"  # as many values as before, under another shape
            if not kept and sizes[0] == 0 and value.type.tensor_type.shape.dim[0].dim_param not in rows:
                raise PolicyError(f"intermediate result {name!r} has more rows than attempts", where=path, mend=EXPORT)
