"""The scene of a recording, built again from what the recording carries, to be filmed afterwards."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Sequence
from types import TracebackType
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SimulationError, one_line, unknown
from pipeline.simulation.rendering import FilmCamera


class SceneFilm:
    """Renders states of a recording through the cameras of its own scene.

    Args:
        xml: the recording's scene.xml.
        half_m: half edge of its cube [m]; scenes are attached with the nominal one.
        cameras: names of cameras of the scene.
        width: of every picture [px].
        height: of every picture [px].

    Raises:
        SimulationError: the scene does not compile, asks for other files, or nothing can render here.
        ConfigError: it has no camera of that name.
    """

    def __init__(self, xml: bytes, half_m: float, cameras: Sequence[str], *, width: int, height: int) -> None:
        model = _compiled(xml)
        known = [model.camera(i).name for i in range(model.ncam)]
        for name in cameras:
            if name not in known:
                raise unknown("camera", name, known)
        if "object" in [model.geom(i).name for i in range(model.ngeom)]:
            model.geom_size[model.geom("object").id] = half_m
        self.cameras = tuple(cameras)
        self._film = FilmCamera(model, width=width, height=height)

    def render(self, state: NDArray[np.float64]) -> dict[str, NDArray[np.uint8]]:
        """Camera -> what it sees in an mjSTATE_INTEGRATION row, RGB, shape (height, width, 3)."""
        found: dict[str, NDArray[np.uint8]] = {}
        for name in self.cameras:
            self._film.look(name)
            found[name] = self._film.frames(state[None])[0]
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._film.close()


def _compiled(xml: bytes) -> mujoco.MjModel:
    if b"file=" in xml or b"<plugin" in xml:
        raise SimulationError("the attached scene asks for other files or plugins", where="scene.xml",
                              mend="film it where it was recorded: only scenes that stand alone are opened")
    try:
        return mujoco.MjModel.from_xml_string(xml.decode())
    except (ValueError, UnicodeDecodeError) as error:
        raise SimulationError(f"the attached scene does not compile: {one_line(error)}", where="scene.xml",
                              mend="record it again with this version") from error
