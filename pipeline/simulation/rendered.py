"""Pictures that were never taken: a camera's view of states that were simulated, rendered when they are asked for."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.files import sha256
from pipeline.footage import Picture
from pipeline.protocols import Array
from pipeline.simulation.appearance import look_draws, look_from
from pipeline.simulation.eyes import Eyes, renderer_hash
from schemas.episode import Episode


class RenderedFootage:
    """See pipeline.footage.Footage; a picture a frame, none of them old.

    Args:
        episode: simulated; its scene says size of the cube, and the look it was drawn.
        camera: one of those that `eyes` renders.
        blobs: hashes of the files that its states follow from, the recording first: whoever has one of them
            forgotten must find these pictures.
        states: gives its states, mjSTATE_INTEGRATION rows, one a frame; called only if pictures are asked for.
        eyes: renders; called only if pictures are asked for.
        size: width and height of the pictures [px].
    """

    def __init__(self, episode: Episode, camera: str, blobs: tuple[str, ...], states: Callable[[], Array],
                 eyes: Callable[[], Eyes], size: tuple[int, int]) -> None:
        self._episode, self._camera, self._states, self._eyes = episode, camera, states, eyes
        look = ",".join(f"{d.name}={d.value!r}" for d in look_draws(episode.scene.draws)) or "nominal"
        self.source = " ".join([*blobs, episode.id, camera, f"{size[0]}x{size[1]}", renderer_hash(),
                                sha256(look.encode()), look])
        self.repeated = 0

    @property
    def skew_s(self) -> NDArray[np.float32]:
        """See Footage."""
        return np.zeros(self._episode.frames, np.float32)

    def pictures(self) -> Iterator[Picture]:
        """See Footage.

        Raises:
            DatasetError: there are more or fewer states than frames.
            SimulationError: nothing can render here, or the states are not of this scene.
        """
        states, scene = self._states(), self._episode.scene
        if len(states) != self._episode.frames:
            raise DatasetError(f"{len(states)} states for {self._episode.frames} frames", where=f"episode "
                               f"{self._episode.id}", mend="it was made by other code: start a new run")
        look, half_m = look_from(scene.draws), np.array([scene.object_half_m])
        for state in states:
            yield self._eyes().see(state[None], half_m, [look])[self._camera][0]
