"""OnnxPolicy: a released policy for n attempts at once, by ONNX Runtime alone: no torch, no lerobot."""

from pathlib import Path

import numpy as np

from pipeline.errors import PolicyError
from pipeline.frames import ACTION
from pipeline.policies.ensembling import Ensembler
from pipeline.policies.onnx_guard import EXPORT, checked_model
from pipeline.policies.runtime import Session
from pipeline.protocols import Array, Ids, Observation

ROWS = 16
"""Batches are filled up to a multiple of this. Vector code handles the last few values of an array in
another way than the rest; with whole vectors only, an attempt's action does not depend on its company."""

MAX_DECAY = 10.0


class OnnxPolicy:
    """Implements pipeline.protocols.Policy; the memory of an attempt is its overlapping chunks."""

    def __init__(self, path: Path, *, threads: int = 1) -> None:
        """Load a policy file after checking it.

        Args:
            path: an ONNX file, see pipeline.policies.export.
            threads: of ONNX Runtime; one, because simulation uses the others.

        Raises:
            PolicyError: the file is hostile, damaged, a pickle, or for another robot.
        """
        data, chunk, metadata = checked_model(path)
        try:
            self._session = Session(data, threads)
            decay = float(metadata["ensemble_decay"])
        except (KeyError, ValueError) as error:
            raise PolicyError("the file does not say how its chunks are ensembled", where=path, mend=EXPORT) from error
        except Exception as error:  # ONNX Runtime raises its own types, none of them public
            raise PolicyError("ONNX Runtime refuses the file", where=path, mend=EXPORT) from error
        if not abs(decay) <= MAX_DECAY:
            raise PolicyError(f"ensemble_decay is {decay}", where=path, mend=f"{EXPORT}; at most {MAX_DECAY}")
        self._chunk, self._path = chunk, path
        self._ensembler = Ensembler(chunk, len(ACTION), decay)

    def reset(self, n: int) -> None:
        """Forget everything and prepare for n attempts."""
        self._ensembler.reset(n)

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Actions (len(ids), 5) in the order of ids, each a mean over its attempt's chunks."""
        return self._ensembler.step(self.chunks(observation), ids)

    def chunks(self, observation: Observation) -> Array:
        """What the network alone says: chunks (n, chunk, 5) in action units; remembers nothing."""
        n = len(observation.state)
        if n == 0:
            return np.zeros((0, self._chunk, len(ACTION)))
        rows = -(-n // ROWS) * ROWS
        state = np.zeros((rows, observation.state.shape[1]), np.float32)
        environment = np.zeros((rows, observation.environment.shape[1]), np.float32)
        state[:n], environment[:n] = observation.state, observation.environment
        try:
            chunk = self._session.run(state, environment)
        except Exception as error:  # see above
            raise PolicyError("ONNX Runtime cannot run the policy on this observation", where=self._path,
                              mend=EXPORT) from error
        return chunk[:n].astype(np.float64)

    def memory(self, ids: Ids) -> Array:
        """The ensembling memory of the attempts as rows, part of a restorable state."""
        return self._ensembler.memory(ids)

    def restore(self, ids: Ids, rows: Array) -> None:
        """Set the memory of attempts to rows that memory() gave."""
        self._ensembler.restore(ids, rows)
