"""ONNX export of ACT: the trained policy as a graph written by hand, normalisation inside, no training part.

Inputs `state` (n, 16) and `pictures` (n, 3, height, width) in [0, 255] are observations as they are, output `chunk`
(n, chunk, 5) is in the units of pipeline.frames.ACTION. The narrow backbone is exported, not the ResNet18 that the
checkpoint has room for. What does not depend on the observation is worked out here: the latent token is a bias, and
what the decoder says to itself before it looks at anything is a constant (its input is 0 in lerobot's ACT).
"""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from pipeline.frames import ACTION, STATE
from pipeline.policies.act_net import ActShape
from pipeline.policies.act_training import FittedAct
from pipeline.policies.ensembling import DECAY
from pipeline.policies.export import IR, OPSET, write_within
from pipeline.policies.network import Weights, array, tensor
from pipeline.policies.runtime import Session

type Values = NDArray[np.float32 | np.int64]

PARITY_ROWS = 64
NORM_EPS, FROZEN_EPS = 1e-5, 1e-5
"""Of nn.LayerNorm and FrozenBatchNorm2d."""
LAYERS = range(1, 5)
"""Of ResNet18, two blocks each."""


class _Graph:
    """Nodes and constants under construction."""

    def __init__(self, shape: ActShape, weights: Weights) -> None:
        self.shape, self.weights = shape, weights
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[str, Values] = {}

    def weight(self, name: str) -> NDArray[np.float64]:
        """A trained array by its name below `model`."""
        return self.weights[f"model.{name}"].astype(np.float64)

    def constant(self, name: str, values: NDArray[Any]) -> str:
        """Keep an array, 64 bit integers as they are and the rest as float32; returns its name."""
        self.constants[name] = np.ascontiguousarray(values, None if values.dtype == np.int64 else np.float32)
        return name

    def add(self, op: str, inputs: tuple[str, ...], output: str, **attributes: Any) -> str:
        """Append a node, named by its output."""
        self.nodes.append(helper.make_node(op, list(inputs), [output], name=output, **attributes))
        return output

    def linear(self, value: str, weight: NDArray[Any], bias: NDArray[Any], output: str) -> str:
        """value @ weight.T + bias, over the last axis."""
        product = self.add("MatMul", (value, self.constant(f"{output}.weight", weight.T)), f"{output}.product")
        return self.add("Add", (product, self.constant(f"{output}.bias", bias)), output)

    def layer(self, value: str, name: str, output: str) -> str:
        """A trained linear layer."""
        return self.linear(value, self.weight(f"{name}.weight"), self.weight(f"{name}.bias"), output)

    def norm(self, value: str, name: str, output: str) -> str:
        """A trained LayerNorm."""
        scale, shift = (self.constant(f"{output}.{k}", self.weight(f"{name}.{k}")) for k in ("weight", "bias"))
        return self.add("LayerNormalization", (value, scale, shift), output, axis=-1, epsilon=NORM_EPS)

    def reshape(self, value: str, sizes: tuple[int, ...], output: str) -> str:
        """The same values for each attempt in another shape; 0 keeps the number of attempts."""
        return self.add("Reshape", (value, self.constant(f"{output}.sizes", np.array((0, *sizes), np.int64))), output)

    def heads(self, value: str, tokens: int, output: str, order: tuple[int, ...] = (0, 2, 1, 3)) -> str:
        """(n, tokens, dim) -> (n, heads, tokens, dim / heads), or with another order of these axes."""
        parts = self.shape.heads
        apart = self.reshape(value, (tokens, parts, self.shape.dim // parts), f"{output}.apart")
        return self.add("Transpose", (apart,), output, perm=list(order))


def _backbone(graph: _Graph) -> str:
    """pictures -> feature map (n, channels, rows, columns)."""

    def convolve(value: str, conv: str, norm: str, output: str, stride: int) -> str:
        w = graph.weight(f"backbone.{conv}.weight")
        scale = graph.weight(f"backbone.{norm}.weight")
        scale = scale / np.sqrt(graph.weight(f"backbone.{norm}.running_var") + FROZEN_EPS)
        shift = graph.weight(f"backbone.{norm}.bias") - graph.weight(f"backbone.{norm}.running_mean") * scale
        size = w.shape[2]
        return graph.add("Conv", (value, graph.constant(f"{output}.weight", w * scale[:, None, None, None]),
                                  graph.constant(f"{output}.bias", shift)), output,
                         kernel_shape=[size, size], strides=[stride, stride], pads=[size // 2] * 4)

    value = graph.add("Relu", (convolve("normalised", "conv1", "bn1", "stem", 2),), "stem.relu")
    value = graph.add("MaxPool", (value,), "stem.pool", kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1])
    for layer in LAYERS:
        for block in range(2):
            name, stride = f"layer{layer}.{block}", 2 if layer > 1 and block == 0 else 1
            first = convolve(value, f"{name}.conv1", f"{name}.bn1", f"{name}.first", stride)
            first = graph.add("Relu", (first,), f"{name}.first.relu")
            second = convolve(first, f"{name}.conv2", f"{name}.bn2", f"{name}.second", 1)
            beside = convolve(value, f"{name}.downsample.0", f"{name}.downsample.1", f"{name}.beside", stride) \
                if stride == 2 else value
            total = graph.add("Add", (second, beside), f"{name}.sum")
            value = graph.add("Relu", (total,), f"{name}.relu")
    return value


def _tokens(graph: _Graph, scales: Any, positions: NDArray[np.float64]) -> tuple[str, int]:
    """state and feature map -> the encoder's tokens (n, tokens, dim), and how many: latent, state, picture."""
    dim, pixels = graph.shape.dim, len(positions)
    mean, std = (v[:, None, None] for v in (scales.pixel_mean, scales.pixel_std))
    centred = graph.add("Sub", ("pictures", graph.constant("pixel_mean", mean)), "centred")
    graph.add("Div", (centred, graph.constant("pixel_std", std)), "normalised")
    features = _backbone(graph)
    flat = graph.reshape(features, (len(graph.weight("encoder_img_feat_input_proj.weight")[0]), pixels), "pixels.flat")
    flat = graph.add("Transpose", (flat,), "pixels", perm=[0, 2, 1])
    seen = graph.linear(flat, graph.weight("encoder_img_feat_input_proj.weight")[:, :, 0, 0],
                        graph.weight("encoder_img_feat_input_proj.bias"), "pixels.tokens")
    weight = graph.weight("encoder_robot_state_input_proj.weight") / scales.state_std
    bias = graph.weight("encoder_robot_state_input_proj.bias") - weight @ scales.state_mean
    latent = graph.weight("encoder_latent_input_proj.bias")  # of a latent that is 0
    own = graph.linear("state", np.concatenate([np.zeros_like(weight), weight]), np.concatenate([latent, bias]), "own")
    own = graph.reshape(own, (2, dim), "own.tokens")
    return graph.add("Concat", (own, seen), "tokens", axis=1), 2 + pixels


def _attend(graph: _Graph, name: str, queries: str, keys: str, values: str, tokens: int, output: str) -> str:
    """Self-attention of the encoder over its tokens."""
    dim = graph.shape.dim
    weight, bias = (graph.weight(f"{name}.in_proj_{k}") for k in ("weight", "bias"))
    query, key, value = (
        graph.linear(given, weight[k * dim:(k + 1) * dim], bias[k * dim:(k + 1) * dim], f"{output}.{part}")
        for k, (part, given) in enumerate((("query", queries), ("key", keys), ("value", values))))
    query = graph.heads(query, tokens, f"{output}.queries")
    return _mix(graph, name, query, key, value, tokens, tokens, output)


def _mix(graph: _Graph, name: str, query: str, key: str, value: str, asked: int, tokens: int, output: str) -> str:
    """What `asked` queries (n or 1, heads, asked, width) take from keys and values (n, tokens, dim)."""
    keys = graph.heads(key, tokens, f"{output}.keys", (0, 2, 3, 1))
    values = graph.heads(value, tokens, f"{output}.values")
    scores = graph.add("MatMul", (query, keys), f"{output}.scores")
    scale = graph.constant(f"{output}.scale", np.array((graph.shape.dim // graph.shape.heads) ** -0.5))
    shares = graph.add("Softmax", (graph.add("Mul", (scores, scale), f"{output}.scaled"),), f"{output}.shares", axis=-1)
    taken = graph.add("MatMul", (shares, values), f"{output}.taken")
    taken = graph.add("Transpose", (taken,), f"{output}.turned", perm=[0, 2, 1, 3])
    taken = graph.reshape(taken, (asked, graph.shape.dim), f"{output}.joined")
    return graph.layer(taken, f"{name}.out_proj", output)


def _feed(graph: _Graph, value: str, name: str, norm: str, output: str) -> str:
    """Feed-forward layers, their sum with what goes in, and the norm after it."""
    inner = graph.add("Relu", (graph.layer(value, f"{name}.linear1", f"{output}.inner"),), f"{output}.relu")
    total = graph.add("Add", (value, graph.layer(inner, f"{name}.linear2", f"{output}.outer")), f"{output}.sum")
    return graph.norm(total, f"{name}.{norm}", output)


def _encoder(graph: _Graph, value: str, positions: str, tokens: int) -> str:
    for k in range(graph.shape.layers):
        name = f"encoder.layers.{k}"
        placed = graph.add("Add", (value, positions), f"{name}.placed")
        mixed = _attend(graph, f"{name}.self_attn", placed, placed, value, tokens, f"{name}.attention")
        total = graph.add("Add", (value, mixed), f"{name}.attended")
        value = _feed(graph, graph.norm(total, f"{name}.norm1", f"{name}.normed"), name, "norm2", name)
    return value


def _decoder(graph: _Graph, told: str, positions: str, tokens: int) -> str:
    """Tokens -> normalised actions (n, chunk, 5)."""
    shape, name = graph.shape, "decoder.layers.0"
    dim, parts = shape.dim, shape.heads
    # Queries are the same whatever is seen: self-attention over zeros gives its value bias through its output layer.
    own = graph.weight(f"{name}.self_attn.out_proj.weight") @ graph.weight(f"{name}.self_attn.in_proj_bias")[2 * dim:]
    own = own + graph.weight(f"{name}.self_attn.out_proj.bias")
    own = (own - own.mean()) / np.sqrt(own.var() + NORM_EPS)
    own = own * graph.weight(f"{name}.norm1.weight") + graph.weight(f"{name}.norm1.bias")
    weight, bias = (graph.weight(f"{name}.multihead_attn.in_proj_{k}") for k in ("weight", "bias"))
    asked = (own + graph.weight("decoder_pos_embed.weight")) @ weight[:dim].T + bias[:dim]
    query = graph.constant("decoder.queries", asked.reshape(1, shape.chunk, parts, dim // parts).transpose(0, 2, 1, 3))
    placed = graph.add("Add", (told, positions), "decoder.placed")
    key = graph.linear(placed, weight[dim:2 * dim], bias[dim:2 * dim], "decoder.key")
    value = graph.linear(told, weight[2 * dim:], bias[2 * dim:], "decoder.value")
    taken = _mix(graph, f"{name}.multihead_attn", query, key, value, shape.chunk, tokens, "decoder.attention")
    total = graph.add("Add", (taken, graph.constant("decoder.own", own)), "decoder.attended")
    fed = _feed(graph, graph.norm(total, f"{name}.norm2", "decoder.normed"), name, "norm3", "decoder")
    return graph.norm(fed, "decoder.norm", "decoder.out")


def build_act(fitted: FittedAct) -> bytes:
    """The bytes of the ONNX file."""
    graph, shape = _Graph(fitted.shape, fitted.weights), fitted.shape
    pixels = _pixel_positions(fitted)
    tokens, count = _tokens(graph, fitted.scales, pixels)
    places = np.concatenate([graph.weight("encoder_1d_feature_pos_embed.weight"), pixels])
    positions = graph.constant("positions", places)
    told = _encoder(graph, tokens, positions, count)
    said = _decoder(graph, told, positions, count)
    std, mean = (v.astype(np.float64) for v in (fitted.scales.action_std, fitted.scales.action_mean))
    head, bias = graph.weight("action_head.weight"), graph.weight("action_head.bias")
    graph.linear(said, head * std[:, None], bias * std + mean, "chunk")
    rows = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", *sizes]) for name, sizes in (
        ("state", [len(STATE)]), ("pictures", [3, shape.height, shape.width]), ("chunk", [shape.chunk, len(ACTION)]))]
    initializers = [
        numpy_helper.from_array(values, name)  # pyright: ignore[reportUnknownMemberType]
        for name, values in sorted(graph.constants.items())]
    model = helper.make_model(
        helper.make_graph(graph.nodes, "act", rows[:2], rows[2:], initializers), producer_name="hardcase",
        opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
    helper.set_model_props(model, {"ensemble_decay": repr(DECAY), "camera": shape.camera})
    onnx.checker.check_model(model, full_check=True)  # pyright: ignore[reportUnknownMemberType]
    return model.SerializeToString(deterministic=True)


def _pixel_positions(fitted: FittedAct) -> NDArray[np.float64]:
    """lerobot's own position of each pixel of the feature map, shape (pixels, dim)."""
    model: Any = fitted.policy().model
    rows, columns = (-(-size // 32) for size in (fitted.shape.height, fitted.shape.width))
    places = model.encoder_cam_feat_pos_embed(torch.zeros(1, 1, rows, columns))
    return array(places)[0].reshape(fitted.shape.dim, -1).T.astype(np.float64)


def act_parity(fitted: FittedAct, model: bytes) -> float:
    """Largest |PyTorch - ONNX Runtime| over a batch of random observations, in action units."""
    rng, shape, s = np.random.default_rng(0), fitted.shape, fitted.scales
    state = (s.state_mean + s.state_std * rng.normal(0, 1, (PARITY_ROWS, len(STATE)))).astype(np.float32)
    pictures = rng.integers(0, 256, (PARITY_ROWS, 3, shape.height, shape.width)).astype(np.float32)
    batch = {"observation.state": tensor((state - s.state_mean) / s.state_std),
             shape.feature: tensor((pictures - s.pixel_mean[:, None, None]) / s.pixel_std[:, None, None])}
    expected = array(fitted.policy().predict_action_chunk(batch)) * s.action_std + s.action_mean
    got = Session(model).run_named({"state": state, "pictures": pictures})
    return float(np.abs(got - expected).max())


def export_act(fitted: FittedAct, path: Path) -> float:
    """Write the ONNX file; return the largest difference to PyTorch in action units.

    Raises:
        PolicyError: the difference is above 1e-5.
    """
    model = build_act(fitted)
    return write_within(path, model, act_parity(fitted, model))
