"""ONNX Runtime as we use it: one thread unless told otherwise, no spinning, two inputs, one output."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnxruntime  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import NDArray

ort: Any = onnxruntime
"""It has no types of its own."""


class Session:
    """A loaded model; maps observations to chunks."""

    def __init__(self, model: bytes, threads: int = 1) -> None:
        """Load a model; whatever ONNX Runtime dislikes is raised as an exception of its own.

        Args:
            model: bytes of an ONNX file, checked before by pipeline.policies.onnx_guard.
            threads: one, because the simulation uses the other cores.
        """
        options = ort.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
        options.log_severity_level = 4
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # the cores are shared
        self._session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def run(self, state: NDArray[np.float32], environment: NDArray[np.float32]) -> NDArray[np.float32]:
        """Chunks (n, chunk, 5) for state (n, 16) and environment (n, 7)."""
        return self.run_named({"state": state, "environment": environment})

    def run_named(self, inputs: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        """Chunks (n, chunk, 5) for inputs by name, n rows each."""
        return self._session.run(["chunk"], dict(inputs))[0]
