"""What the cameras of a recorded scene saw, rendered again from the states that the recording holds."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SimulationError
from pipeline.simulation.rendering import FilmCamera


def refilm(scene: bytes, states: NDArray[np.float64], cameras: Sequence[str], *, width: int,
           height: int) -> dict[str, NDArray[np.uint8]]:
    """Pictures of every camera at every state.

    Args:
        scene: scene.xml, as every recording of a simulated robot carries it.
        states: mjSTATE_INTEGRATION rows, shape (n, nstate); trace.sim_state.
        cameras: names of cameras of the scene.
        width: of every picture [px].
        height: of every picture [px].

    Returns:
        Camera -> RGB, shape (n, height, width, 3).

    Raises:
        SimulationError: nothing can render here, the scene does not load, lacks a camera, or has other states.
    """
    try:
        model = mujoco.MjModel.from_xml_string(scene.decode())
    except ValueError as error:
        raise SimulationError(f"the recorded scene does not load: {error}", where="scene.xml",
                              mend="render from a recording that carries its whole scene") from error
    with FilmCamera(model, camera=cameras[0], width=width, height=height) as film:
        pictures: dict[str, NDArray[np.uint8]] = {}
        for name in cameras:
            film.look(name)
            pictures[name] = film.frames(states)
    return pictures
