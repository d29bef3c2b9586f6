"""The pictures of a run's episodes: which of them can be shown through the cameras of the recipe, and by what."""

from collections.abc import Iterable

from pipeline.errors import DatasetError
from pipeline.footage import Footage, FootageOf
from pipeline.lerobot_view.filmed import once
from pipeline.recording.camera import FILM, RecordedFootage
from pipeline.store import Store
from schemas.episode import VARIANTS, Episode
from schemas.recipe import Recipe


def footage_of(store: Store, recipe: Recipe) -> FootageOf | None:
    """What the cameras of a recipe saw in recordings of a store; None where the recipe has no camera."""
    cameras = recipe.dataset.cameras
    if not cameras:
        return None

    def get(episode: Episode, camera: str) -> Footage:
        if episode.origin in VARIANTS or episode.blob is None:
            raise DatasetError(f"a variant has no picture of camera {camera!r}", where=f"episode {episode.id}",
                               mend=f"leave {episode.origin} out of dataset.sources, or dataset.cameras out")
        try:
            return RecordedFootage(store.blob(episode.blob), camera, episode.frames, blob=episode.blob,
                                   max_skew_s=cameras[camera].max_skew_s)
        except DatasetError as error:
            raise DatasetError(error.what, where=f"episode {episode.id}, {error.where}", mend=FILM) from error

    return once(get)


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
