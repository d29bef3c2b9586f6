"""The pictures of a run's episodes: which of them can be shown through the cameras of the recipe, and by what."""

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING

from pipeline.errors import DatasetError
from pipeline.footage import Footage, FootageOf
from pipeline.frames import Frames
from pipeline.lerobot_view.filmed import once
from pipeline.protocols import Array
from pipeline.recording.camera import FILM, RecordedFootage
from pipeline.recording.read import read_episode
from pipeline.store import Store
from schemas.episode import VARIANTS, Episode
from schemas.recipe import CameraConfig, Recipe

if TYPE_CHECKING:
    from pipeline.simulation.eyes import Eyes

SIMULATED = ("scripted", *VARIANTS)
"""Origins of what may be rendered, where it was not recorded on a robot."""
BATCH = 256
"""Variants that are played again together; their states take about 20 MB."""


def footage_of(store: Store, recipe: Recipe, rendered: "_Rendered | None" = None) -> FootageOf | None:
    """What the cameras of a recipe saw; None where the recipe has no camera.

    A recording shows what was taken. What was simulated without the camera is rendered where the recipe says so and
    there is somebody to render, see `filming`.
    """
    cameras = recipe.dataset.cameras
    if not cameras:
        return None

    def get(episode: Episode, camera: str) -> Footage:
        wanted = cameras[camera]
        if wanted.rendered and rendered is not None and episode.blob and episode.origin in SIMULATED \
                and episode.scene.twin is None:
            return rendered.footage(episode, camera, wanted)
        if episode.origin in VARIANTS or episode.blob is None:
            raise DatasetError(f"a variant has no picture of camera {camera!r}", where=f"episode {episode.id}",
                               mend=f"leave {episode.origin} out of dataset.sources, set dataset.cameras.{camera}."
                                    "rendered, or leave dataset.cameras out")
        try:
            return RecordedFootage(store.blob(episode.blob), camera, episode.frames, blob=episode.blob,
                                   max_skew_s=wanted.max_skew_s)
        except DatasetError as error:
            raise DatasetError(error.what, where=f"episode {episode.id}, {error.where}", mend=FILM) from error

    return once(get)


@contextmanager
def filming(store: Store, recipe: Recipe, frames: Callable[[Episode], Frames],
            episodes: Sequence[Episode]) -> Generator[FootageOf | None]:
    """`footage_of` with a renderer: recordings are shown by the states they hold, variants by those of their replay.

    Args:
        store: where the episodes are kept.
        recipe: its dataset.cameras.
        frames: gives an episode's frames.
        episodes: those that will be asked for: variants among them are played again in batches.
    """
    rendered = _Rendered(store, recipe, frames, [e for e in episodes if e.origin in VARIANTS])
    try:
        yield footage_of(store, recipe, rendered)
    finally:
        rendered.close()


class _Rendered:
    """Renders simulated episodes; one GL context a camera, opened when the first picture is asked for."""

    def __init__(self, store: Store, recipe: Recipe, frames: Callable[[Episode], Frames],
                 variants: Sequence[Episode]) -> None:
        self._store, self._recipe, self._frames, self._variants = store, recipe, frames, variants
        self._place = {e.id: k for k, e in enumerate(variants)}
        self._batch = lru_cache(maxsize=1)(self._played)
        self._open: dict[str, Eyes] = {}

    def close(self) -> None:
        """Free what was opened."""
        for eyes in self._open.values():
            eyes.close()
        self._open.clear()

    def footage(self, episode: Episode, camera: str, wanted: CameraConfig) -> Footage:
        """The pictures of one episode."""
        from pipeline.simulation.rendered import RenderedFootage

        width, height = int(wanted.width or 0), int(wanted.height or 0)
        parents = [str(e.blob) for e in self._store.episodes([episode.parent])] if episode.parent else []
        return RenderedFootage(episode, camera, (*parents, str(episode.blob)), lambda: self._states(episode),
                               lambda: self._eyes(camera, width, height), (width, height))

    def _eyes(self, camera: str, width: int, height: int) -> "Eyes":
        if camera not in self._open:
            from pipeline.simulation.bodies import load_body
            from pipeline.simulation.eyes import Eyes
            from pipeline.simulation.model import compose

            xml = compose(load_body(self._recipe.robot), self._recipe.scene).xml
            self._open[camera] = Eyes(xml, (camera,), width=width, height=height)
        return self._open[camera]

    def _states(self, episode: Episode) -> Array:
        if episode.origin not in VARIANTS:
            return read_episode(self._store.blob(str(episode.blob)))[1].sim_state
        return self._batch(self._place[episode.id] // BATCH)[episode.id]

    def _played(self, number: int) -> dict[str, Array]:
        """The states of one batch of variants, played again."""
        from stages.augment import replayed

        batch = self._variants[number * BATCH:(number + 1) * BATCH]
        parents = {e.id: e for e in self._store.episodes({str(e.parent) for e in batch})}
        return replayed([(e, (p := parents[str(e.parent)], self._frames(p))) for e in batch],
                        threads=self._recipe.threads)


def shown(episodes: Iterable[Episode], footage: FootageOf | None, recipe: Recipe) -> list[Episode]:
    """The episodes that every camera of the recipe has pictures of; all where it has no camera.

    An episode that its sources leave out anyway is not looked at.

    Raises:
        DatasetError: not one has; says what the first lacks.
    """
    if footage is None:
        return list(episodes)
    chosen, lacking = list[Episode](), list[DatasetError]()
    for episode in episodes:
        try:
            if episode.origin in recipe.dataset.sources:
                for camera in recipe.dataset.cameras:
                    footage(episode, camera)
            chosen.append(episode)
        except DatasetError as error:
            lacking.append(error)
    if lacking and not any(e.origin in recipe.dataset.sources for e in chosen):
        raise lacking[0]
    return chosen
