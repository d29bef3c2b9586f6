"""Pictures of a simulation without a display: EGL first, OSMesa where there is none."""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

import ctypes
import io
import os
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pipeline.errors import SimulationError, one_line

INSTALL = "sudo apt-get install -y libegl1 libosmesa6 libgl1"
"""Debian and Ubuntu packages of both ways to render without a display."""

BACKENDS = ("egl", "osmesa", "glfw")
"""What MUJOCO_GL may ask for here; glfw needs a display."""


@dataclass(frozen=True, slots=True)
class View:
    """A camera that no model needs to have: it looks at a point from a distance."""

    look_at_m: tuple[float, float, float]
    distance_m: float
    azimuth_deg: float
    """Heading of the line of sight from the x axis, counter-clockwise from above."""
    elevation_deg: float
    """Below 0 it looks down."""


CLOSE_UP = View(look_at_m=(0.27, 0.0, 0.08), distance_m=0.72, azimuth_deg=180.0, elevation_deg=-42.0)
"""The workspace of the table scene, near enough to see what the fingers do in a small picture."""


@cache
def backend() -> str:
    """The OpenGL backend this process renders with: MUJOCO_GL where it is set, else EGL, else OSMesa.

    A process has one: PyOpenGL binds itself to the first it is asked for. So EGL is tried with
    ctypes before anything of PyOpenGL is imported; a failed import could not be taken back.

    Raises:
        SimulationError: MUJOCO_GL forbids rendering or names no backend, or neither library is usable.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if asked in BACKENDS:
        return asked
    if asked not in ("", "1", "on", "true", "enable", "enabled"):
        raise SimulationError("rendering is switched off", where=f"MUJOCO_GL={asked}",
                              mend="unset MUJOCO_GL, or set it to egl or osmesa")
    if _egl_opens():
        return "egl"
    if _loads("libOSMesa.so.8") or _loads("libOSMesa.so"):
        return "osmesa"
    raise SimulationError("no way to render without a display", where="libEGL.so.1, libOSMesa.so.8", mend=INSTALL)


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _egl_opens() -> bool:
    """Whether some EGL device opens. Source: EGL_EXT_device_enumeration, EGL_EXT_platform_device."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
        egl.eglGetProcAddress.restype = ctypes.c_void_p
        query = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
        platform = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    except (OSError, AttributeError):
        return False
    if not query or not platform:
        return False
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    devices, found = (pointer * 16)(), integer(0)
    query_devices = ctypes.CFUNCTYPE(ctypes.c_uint, integer, ctypes.POINTER(pointer), ctypes.POINTER(integer))(query)
    get_display = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(platform)
    if not query_devices(16, devices, ctypes.byref(found)):
        return False
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    displays = (get_display(0x313F, device, None) for device in devices[:found.value])  # EGL_PLATFORM_DEVICE_EXT
    return any(display and egl.eglInitialize(display, None, None) for display in displays)


def _open_context(width: int, height: int) -> Any:
    """A current GL context of mujoco's class for the backend; its default by MUJOCO_GL is bound at import."""
    name = backend()
    try:
        context: Any = import_module(f"mujoco.{name}").GLContext(width, height)
        context.make_current()
    except Exception as error:  # PyOpenGL and drivers raise types of their own, and ImportError, and AttributeError
        raise SimulationError(f"{name} does not render: {one_line(error)}", where=f"backend {name}",
                              mend=INSTALL) from error
    return context


class FilmCamera:
    """Turns restorable states of one model into film strips; one GL context for all of them.

    The camera is one of the model's by name, a View, or by default one that sees the whole model.

    Opening costs about 0.12 CPU s, a frame of 160 x 120 about 2 ms with software rendering: use one
    camera for many strips. The model may be changed between strips (the size of a geom, a colour).

    Raises:
        SimulationError: no backend works, the model has no camera of that name, or, from its methods, the
            states are not this model's.
    """

    def __init__(self, model: mujoco.MjModel, *, camera: str | View | None = None,
                 width: int = 160, height: int = 120) -> None:
        self.model, self.width, self.height = model, width, height
        self._data = mujoco.MjData(model)
        self._view = _view(model, camera)
        self._shift_m = self._turn_rad = np.zeros(3)
        self._option = mujoco.MjvOption()
        self._context = _open_context(width, height)
        shadows, model.vis.quality.shadowsize = model.vis.quality.shadowsize, 0  # else 67 MB for a map nobody draws
        try:
            self._renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50.value)
        finally:
            model.vis.quality.shadowsize = shadows
        mujoco.mjr_resizeOffscreen(width, height, self._renderer)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._renderer)
        self._scene = mujoco.MjvScene(model=model, maxgeom=2000)
        for effect in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[effect] = 0  # shadows make a frame ten times as dear in software

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Free the GL context; the camera cannot be used afterwards."""
        self._context.make_current()
        self._renderer.free()
        self._context.free()

    def look(self, camera: str | View | None) -> None:
        """See through another camera from now on; SimulationError where the model has none of that name."""
        self._view = _view(self.model, camera)

    def move(self, shift_m: NDArray[np.float64], turn_rad: NDArray[np.float64]) -> None:
        """See from elsewhere from now on, relative to the camera's own pose and along its own axes.

        Args:
            shift_m: how far right, up and back [m], shape (3,).
            turn_rad: pan to the left, tilt up, roll of the camera to the left [rad], shape (3,).
        """
        self._shift_m, self._turn_rad = shift_m, turn_rad

    def retexture(self, texture: int) -> None:
        """Hand a texture of the model that was changed to the renderer."""
        self._context.make_current()
        mujoco.mjr_uploadTexture(self.model, self._renderer, texture)

    def frames(self, rows: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Pictures of k states, mjSTATE_INTEGRATION rows of shape (k, nstate): (k, height, width, 3).

        Raises:
            SimulationError: the rows are not states of this model, or hold values that are not finite.
        """
        kind = mujoco.mjtState.mjSTATE_INTEGRATION.value
        nstate = mujoco.mj_stateSize(self.model, kind)
        if rows.ndim != 2 or rows.shape[1] != nstate or not len(rows):
            raise SimulationError(f"states of shape {rows.shape}, the model needs (k, {nstate}) with k >= 1",
                                  where="film strip", mend="render with the model that recorded the states")
        if not np.isfinite(rows).all():
            raise SimulationError("a state holds a value that is not finite", where=f"row {_first_bad(rows)}",
                                  mend="leave the row out: physics diverged there")
        self._context.make_current()
        pictures = np.empty((len(rows), self.height, self.width, 3), np.uint8)
        window = mujoco.MjrRect(0, 0, self.width, self.height)
        for row, picture in zip(rows, pictures, strict=True):
            mujoco.mj_setState(self.model, self._data, np.ascontiguousarray(row), kind)
            mujoco.mj_kinematics(self.model, self._data)
            mujoco.mj_comPos(self.model, self._data)
            mujoco.mj_camlight(self.model, self._data)
            mujoco.mjv_updateScene(self.model, self._data, self._option, None, self._view,
                                   mujoco.mjtCatBit.mjCAT_ALL.value, self._scene)
            _move(self._scene, self._shift_m, self._turn_rad)
            mujoco.mjr_render(window, self._scene, self._renderer)
            mujoco.mjr_readPixels(picture, None, window, self._renderer)
        return pictures[:, ::-1]  # OpenGL counts rows from below

    def strip(self, rows: NDArray[np.float64], *, quality: int = 82) -> bytes:
        """The frames side by side, first at the left, parted by a thin line, as one WebP picture."""
        frames = self.frames(rows)
        frames[:-1, :, -2:] = 255
        picture = np.concatenate(list(frames), axis=1)
        stream = io.BytesIO()
        Image.fromarray(picture).save(stream, "WEBP", quality=quality, method=2)  # smaller methods' files are larger
        return stream.getvalue()


def film_strip(model: mujoco.MjModel, rows: NDArray[np.float64], *, camera: str | View | None = None,
               width: int = 160, height: int = 120) -> bytes:
    """One film strip of k states, (k, nstate) of mjSTATE_INTEGRATION, k * width x height pixels, as WebP.

    For several strips of a model open one FilmCamera.

    Raises:
        SimulationError: nothing can render here, or the rows are not states of the model.
    """
    with FilmCamera(model, camera=camera, width=width, height=height) as film:
        return film.strip(rows)


def _view(model: mujoco.MjModel, camera: str | View | None) -> mujoco.MjvCamera:
    view = mujoco.MjvCamera()
    if camera is None:
        mujoco.mjv_defaultFreeCamera(model, view)
        return view
    if isinstance(camera, View):
        view.lookat[:] = camera.look_at_m
        view.distance, view.azimuth, view.elevation = camera.distance_m, camera.azimuth_deg, camera.elevation_deg
        return view
    names = [model.camera(i).name for i in range(model.ncam)]
    if camera not in names:
        raise SimulationError(f"the model has no camera {camera!r}", where="film strip",
                              mend=f"use one of: {', '.join(names) or 'none, it has no camera; leave it out'}")
    view.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
    view.fixedcamid = names.index(camera)
    return view


def _move(scene: Any, shift_m: NDArray[np.float64], turn_rad: NDArray[np.float64]) -> None:
    """Move both eyes of a scene's camera; small angles, one turn after the other."""
    if not shift_m.any() and not turn_rad.any():
        return
    pan, tilt, roll = turn_rad
    for eye in scene.camera:
        forward, up = np.array(eye.forward, np.float64), np.array(eye.up, np.float64)
        right = np.cross(forward, up)
        eye.pos = eye.pos + shift_m @ np.stack([right, up, -forward])
        forward = forward + np.tan(tilt) * up - np.tan(pan) * right
        forward /= np.linalg.norm(forward)
        up = up - np.tan(roll) * right
        up -= (up @ forward) * forward
        eye.forward, eye.up = forward, up / np.linalg.norm(up)


def _first_bad(rows: NDArray[np.float64]) -> int:
    return int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
