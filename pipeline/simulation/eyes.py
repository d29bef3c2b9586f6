"""Eyes: pictures of n attempts as the cameras of their own scenes see them, each under its own look.

A policy that sees is driven through `with_eyes`: everybody else renders nothing.
"""

# mujoco is a compiled package without type stubs
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportUnknownArgumentType=false

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import PolicyError, unknown
from pipeline.files import source_hash
from pipeline.protocols import Array, Ids, Observation, Policy, SeeingPolicy
from pipeline.simulation import appearance, rendering
from pipeline.simulation.appearance import Look
from pipeline.simulation.rendering import CLOSE_UP, FilmCamera, View
from pipeline.simulation.world import World

type Pictures = NDArray[np.uint8]
"""RGB, shape (k, height, width, 3)."""

VIEWS: Mapping[str, View] = MappingProxyType({"close": CLOSE_UP})
"""Cameras that no scene needs to have, beside those of the scene itself."""

TEXTURE, TEXELS, SPAN_M = "table", 64, 0.6
"""Name and size of the table's texture, and the width that one copy of it covers [m]."""


class Eyes:
    """Renders simulator states; one GL context for all attempts, cameras and looks.

    Args:
        xml: MJCF of the scene, see pipeline.simulation.model.Setup.
        cameras: names of the scene's cameras or of VIEWS.
        width: of every picture [px].
        height: of every picture [px].

    Raises:
        ConfigError: there is no camera of that name; lists those there are.
        SimulationError: nothing can render here.
    """

    def __init__(self, xml: str, cameras: Sequence[str], *, width: int, height: int) -> None:
        self._model = model = _with_texture(xml)
        known = {**{model.camera(i).name: model.camera(i).name for i in range(model.ncam)}, **VIEWS}
        for name in cameras:
            if name not in known:
                raise unknown("camera", name, known)
        self.cameras: tuple[str, ...] = tuple(cameras)
        self.width, self.height = width, height
        self._views = {name: known[name] for name in cameras}
        self._table, self._cube, self._mark = (model.geom(n).id for n in ("table", "object", "target"))
        self._colours, self._lamps = model.geom_rgba.copy(), model.light_diffuse.copy()
        self._head = np.array(model.vis.headlight.ambient), np.array(model.vis.headlight.diffuse)
        self._textured: tuple[float, ...] = (0.0,) * 3
        self._film = FilmCamera(model, width=width, height=height)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Free the GL context."""
        self._film.close()

    def see(self, states: NDArray[np.float64], half_m: NDArray[np.float64],
            looks: Sequence[Look]) -> dict[str, Pictures]:
        """What every camera sees of k states.

        Args:
            states: mjSTATE_INTEGRATION rows of the scene's model, shape (k, nstate).
            half_m: half edge of each one's cube [m], shape (k,).
            looks: of each.
        """
        found = {name: np.empty((len(states), self.height, self.width, 3), np.uint8) for name in self.cameras}
        for k, (state, half, look) in enumerate(zip(states, half_m, looks, strict=True)):
            self._put_on(look)
            self._model.geom_size[self._cube] = half
            for name, view in self._views.items():
                self._film.look(view)
                found[name][k] = self._film.frames(state[None])[0]
        return found

    def _put_on(self, look: Look) -> None:
        """Change the model to a look."""
        model, light, warm = self._model, look["look_light"], look["look_warmth"]
        tint = light * np.array([1 + warm, 1.0, 1 - warm])
        model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = self._head[0] * tint, self._head[1] * tint
        model.light_diffuse[:] = self._lamps * tint
        model.light_pos[0, :2] = look["look_lamp_x"], look["look_lamp_y"]
        table = look["look_table"] * self._colours[self._table, :3]
        table = table + np.array([look["look_table_red"], 0.0, look["look_table_blue"]])
        model.geom_rgba[self._table, :3] = np.clip(table, 0, 1)
        shift = look["look_object"] * np.array([1.0, -0.5, 1.0])
        for geom in (self._cube, self._mark):
            model.geom_rgba[geom, :3] = np.clip(self._colours[geom, :3] + shift, 0, 1)
        self._film.move(np.array([look[f"look_camera_{a}"] for a in "xyz"]),
                        np.array([look[f"look_camera_{a}"] for a in ("pan", "tilt", "roll")]))
        wanted = look["look_texture"], look["look_grain"], look["look_pattern"]
        if wanted != self._textured:
            self._textured = wanted
            model.tex_data[:] = np.repeat(texture(*wanted).ravel(), 3)
            self._film.retexture(0)


def texture(contrast: float, grain: float, pattern: float) -> NDArray[np.uint8]:
    """Random waves as a texture without seams, shape (TEXELS, TEXELS).

    Args:
        contrast: share of the brightness that varies, 0 for none.
        grain: 0 for few broad waves, 1 for many fine ones.
        pattern: number that decides the waves.
    """
    rng, at = np.random.default_rng(int(pattern)), np.arange(TEXELS) * 2 * np.pi / TEXELS
    finest = 1 + round(9 * min(1.0, max(0.0, grain)))
    waves = np.zeros((TEXELS, TEXELS))
    for _ in range(6):
        u, v = rng.integers(-finest, finest + 1, 2)
        waves += np.cos(u * at[:, None] + v * at[None] + rng.uniform(0, 2 * np.pi))
    waves = (waves - waves.min()) / max(float(np.ptp(waves)), 1e-9)
    return np.rint(255 * (1 - min(1.0, contrast) * waves)).astype(np.uint8)


@contextmanager
def with_eyes(driver: Policy, world: World, looks: Sequence[Look], *others: Policy) -> Generator[Policy]:
    """`driver` with pictures in its observations; as it is where neither it nor one of the others asks for any.

    Args:
        driver: acts.
        world: where; its present state is what is seen.
        looks: of each attempt.
        others: policies that the driver asks, and that may see.

    Raises:
        PolicyError: two policies ask one camera for pictures of different sizes.
        ConfigError: the scene has no such camera.
        SimulationError: nothing can render here.
    """
    wanted = [asked for p in (driver, *others) if isinstance(p, SeeingPolicy) for asked in p.cameras.items()]
    if not wanted:
        yield driver
        return
    sizes = {size for _, size in wanted}
    if len(sizes) > 1:
        raise PolicyError(f"policies side by side want pictures of sizes {sorted(sizes)}", where="cameras",
                          mend="let only policies of one recipe ride together: deploy.shadow: false")
    (height, width), = sizes
    with Eyes(world.setup.xml, tuple(dict(wanted)), width=width, height=height) as eyes:
        yield _Sighted(driver, world, eyes, looks)


class _Sighted:
    """A policy that is handed pictures; see with_eyes."""

    def __init__(self, policy: Policy, world: World, eyes: Eyes, looks: Sequence[Look]) -> None:
        self._policy, self._world, self._eyes, self._looks = policy, world, eyes, looks
        self._half_m = np.array([scene.object_half_m for scene in world.scenes])

    def reset(self, n: int) -> None:
        """Prepare the policy for n attempts."""
        self._policy.reset(n)

    def act(self, observation: Observation, ids: Ids) -> Array:
        """The policy's actions, given what the cameras see now."""
        pictures = self._eyes.see(self._world.batch.state[ids], self._half_m[ids], [self._looks[i] for i in ids])
        return self._policy.act(replace(observation, pictures=pictures), ids)

    def memory(self, ids: Ids) -> Array:
        """The policy's memory."""
        return self._policy.memory(ids)


def renderer_hash() -> str:
    """Hash of the source files that decide which pixels a state and a look become."""
    return source_hash(Path(file) for file in (__file__, appearance.__file__, rendering.__file__))


def _with_texture(xml: str) -> Any:
    """The scene with a texture on its table; white, it changes no pixel."""
    spec = mujoco.MjSpec.from_string(xml)
    spec.add_texture(name=TEXTURE, type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
                     width=TEXELS, height=TEXELS, rgb1=[1, 1, 1], rgb2=[1, 1, 1])
    material = spec.add_material(name=TEXTURE, texuniform=True, texrepeat=[1 / SPAN_M, 1 / SPAN_M])
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = TEXTURE
    spec.geom("table").material = TEXTURE
    return spec.compile()
