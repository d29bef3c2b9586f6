"""OnnxRunner: a trained policy of a legged robot by ONNX Runtime alone: no torch, no SB3."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
import onnxruntime  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import NDArray

from pipeline.errors import PolicyError
from pipeline.policies.onnx_guard import EXPORT, checked_plain_model
from pipeline.protocols import Array

ort: Any = onnxruntime
"""It has no types of its own."""

ROWS = 16
"""Batches are filled up to a multiple of this, so that an attempt's action does not depend on its company."""


class OnnxRunner:
    """Maps what legged robots sense to actions.

    Args:
        path: an ONNX file, see pipeline.ppo.export.
        threads: of ONNX Runtime; one, because the simulation uses the others.

    Raises:
        PolicyError: the file is hostile, damaged, a pickle, or no policy of a legged robot.
    """

    facts: Mapping[str, str]
    """What the file says of itself: body, task, id of the training."""

    def __init__(self, path: Path, *, threads: int = 1) -> None:
        data, self.width, self.joints, self.facts = checked_plain_model(path)
        try:
            self._session = _session(data, threads)
        except Exception as error:  # ONNX Runtime raises its own types, none of them public
            raise PolicyError("ONNX Runtime refuses the file", where=path, mend=EXPORT) from error

    @classmethod
    def of(cls, model: bytes) -> Self:
        """A model of our own that was built just now."""
        self = cls.__new__(cls)
        self._session, self.facts = _session(model, 1), {}
        self.width, self.joints = (int(value.shape[1]) for value in
                                   (self._session.get_inputs()[0], self._session.get_outputs()[0]))
        return self

    def raw(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Mean actions (n, j) for observations (n, w), not cut off."""
        n, width = observation.shape
        if width != self.width:
            raise PolicyError(f"the policy takes {self.width} values, the robot senses {width}", where="observation",
                              mend="use a policy of this body and task: hardcase rl train --body BODY --task TASK")
        filled = np.zeros((-(-n // ROWS) * ROWS, width), np.float32)
        filled[:n] = observation
        return self._session.run(["action"], {"observation": filled})[0][:n]

    def __call__(self, observation: NDArray[np.float32]) -> Array:
        """Actions in [-1, 1], shape (n, j), for what is sensed, shape (n, w)."""
        return np.clip(self.raw(observation), -1.0, 1.0).astype(np.float64)


def _session(model: bytes, threads: int) -> Any:
    options = ort.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 4
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # the cores are shared
    return ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
