"""ActOnnx: a released policy that sees, for n attempts at once, by ONNX Runtime alone: no torch, no lerobot."""

from pathlib import Path

import numpy as np

from pipeline.errors import PolicyError
from pipeline.frames import ACTION
from pipeline.policies.ensembling import Ensembler
from pipeline.policies.onnx_guard import EXPORT, checked_seeing_model
from pipeline.policies.onnx_policy import MAX_DECAY
from pipeline.policies.runtime import Session
from pipeline.protocols import Array, Ids, Observation

ROWS = 16
"""Every run of the network has so many rows, so that an attempt's action does not depend on its company."""


class ActOnnx:
    """Implements pipeline.protocols.SeeingPolicy; the memory of an attempt is its overlapping chunks."""

    def __init__(self, path: Path, *, threads: int = 1) -> None:
        """Load a policy file after checking it.

        Args:
            path: an ONNX file, see pipeline.policies.act_export.
            threads: of ONNX Runtime; one, because simulation uses the others.

        Raises:
            PolicyError: the file is hostile, damaged, a pickle, or for another robot or no camera.
        """
        data, chunk, metadata, (height, width) = checked_seeing_model(path)
        try:
            self._session = Session(data, threads)
            decay, self._camera = float(metadata["ensemble_decay"]), metadata["camera"]
        except (KeyError, ValueError) as error:
            raise PolicyError("the file does not say which camera it sees through and how its chunks are ensembled",
                              where=path, mend=EXPORT) from error
        except Exception as error:  # ONNX Runtime raises its own types, none of them public
            raise PolicyError("ONNX Runtime refuses the file", where=path, mend=EXPORT) from error
        if not abs(decay) <= MAX_DECAY:
            raise PolicyError(f"ensemble_decay is {decay}", where=path, mend=f"{EXPORT}; at most {MAX_DECAY}")
        self._chunk, self._path, self._size = chunk, path, (height, width)
        self._ensembler = Ensembler(chunk, len(ACTION), decay)

    @property
    def cameras(self) -> dict[str, tuple[int, int]]:
        """The camera that it sees through, with height and width of its pictures [px]."""
        return {self._camera: self._size}

    def reset(self, n: int) -> None:
        """Forget everything and prepare for n attempts."""
        self._ensembler.reset(n)

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Actions (len(ids), 5) in the order of ids, each a mean over its attempt's chunks."""
        return self._ensembler.step(self.chunks(observation), ids)

    def chunks(self, observation: Observation) -> Array:
        """What the network alone says: chunks (n, chunk, 5) in action units; remembers nothing.

        Raises:
            PolicyError: the observation has no picture of the camera, or not of its size.
        """
        n, pictures = len(observation.state), observation.pictures.get(self._camera)
        if pictures is None or pictures.shape != (n, *self._size, 3):
            seen = "nothing" if pictures is None else f"pictures of shape {pictures.shape}"
            raise PolicyError(f"the policy sees {seen} through camera {self._camera!r}, it needs {(n, *self._size, 3)}",
                              where=self._path, mend="give it the camera: only simulated robots render one for it")
        found = np.zeros((n, self._chunk, len(ACTION)))
        for start in range(0, n, ROWS):
            rows = slice(start, min(n, start + ROWS))
            state = np.zeros((ROWS, observation.state.shape[1]), np.float32)
            seen = np.zeros((ROWS, 3, *self._size), np.float32)
            state[:rows.stop - start] = observation.state[rows]
            seen[:rows.stop - start] = pictures[rows].transpose(0, 3, 1, 2)
            try:
                chunk = self._session.run_named({"state": state, "pictures": seen})
            except Exception as error:  # see above
                raise PolicyError("ONNX Runtime cannot run the policy on this observation", where=self._path,
                                  mend=EXPORT) from error
            found[rows] = chunk[:rows.stop - start]
        return found

    def memory(self, ids: Ids) -> Array:
        """The ensembling memory of the attempts as rows, part of a restorable state."""
        return self._ensembler.memory(ids)

    def restore(self, ids: Ids, rows: Array) -> None:
        """Set the memory of attempts to rows that memory() gave."""
        self._ensembler.restore(ids, rows)
