"""Cameras of a scene, rendered while the robot moves, in a thread that the control loop does not wait for."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

import threading
from collections import deque
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import unknown
from pipeline.protocols import Picture
from pipeline.simulation.rendering import FilmCamera

BACKLOG = 64
"""States that may wait to be rendered; one takes about 1 KB."""


class SceneCameras:
    """Renders the states that it was shown, through any number of the model's cameras; see protocols.Cameras.

    A state can be rendered later as well as at once, so that states wait while others are being rendered. Only where
    rendering is slower than the robot for long do the oldest give way; `skipped` counts them.

    Args:
        model: the model of the attempt, its cube of the right size: World.batch.get_model(0).
        names: cameras of the model.
        width: of every picture [px].
        height: of every picture [px].

    Raises:
        ConfigError: the model has no camera of that name.
    """

    def __init__(self, model: mujoco.MjModel, names: Sequence[str], *, width: int = 320, height: int = 240) -> None:
        known = [model.camera(i).name for i in range(model.ncam)]
        for name in names:
            if name not in known:
                raise unknown("camera", name, known)
        self.names, self.skipped = tuple(names), 0
        self._model, self._size, self._film = model, (width, height), None
        self._waiting: deque[tuple[NDArray[np.float64], int, int]] = deque(maxlen=BACKLOG)
        self._new = threading.Condition()

    def show(self, state: NDArray[np.float64], tick: int, stamp_ns: int) -> None:
        """Let the cameras take a state, an mjSTATE_INTEGRATION row that nobody changes afterwards; does not wait."""
        with self._new:
            self.skipped += len(self._waiting) == BACKLOG
            self._waiting.append((state, tick, stamp_ns))
            self._new.notify()

    def open(self) -> None:
        """Open the renderer, in the thread that reads; SimulationError where nothing can render here."""
        width, height = self._size
        self._film = FilmCamera(self._model, camera=self.names[0] if self.names else None, width=width, height=height)
        data, kind = mujoco.MjData(self._model), mujoco.mjtState.mjSTATE_INTEGRATION.value
        state = np.empty(mujoco.mj_stateSize(self._model, kind))
        mujoco.mj_getState(self._model, data, state, kind)
        self._film.frames(state[None])  # the first picture takes as long as ten others: shaders are compiled

    def read(self, timeout_s: float) -> list[Picture]:
        """One picture a camera of the state that waits longest, or none where nothing was shown in time."""
        with self._new:
            if not self._waiting:
                self._new.wait(timeout_s)
            if not self._waiting or self._film is None:
                return []
            state, tick, stamp_ns = self._waiting.popleft()
        pictures: list[Picture] = []
        for name in self.names:
            self._film.look(name)
            pixels = self._film.frames(state[None])[0]
            pixels.flags.writeable = False  # nobody writes into it again: a recorder need not copy it
            pictures.append(Picture(name, pixels, stamp_ns, tick))
        return pictures

    def close(self) -> None:
        """Free the renderer."""
        if self._film is not None:
            self._film.close()
            self._film = None
