"""Ingested episodes as they are drawn: every value against time, and the images that each frame uses."""

from dataclasses import replace

import numpy as np

from pipeline.browsing.attempts import of_table
from pipeline.browsing.shown import Pictures, Shown
from pipeline.errors import StoreError
from pipeline.logs.cameras import Images
from pipeline.logs.convert import CAMERA, FRAMES
from pipeline.logs.tables import FrameFile
from pipeline.store import Store
from schemas.episode import Episode


def ingested(store: Store, episode: Episode) -> Shown:
    """What is drawn of an episode of a foreign log.

    Raises:
        StoreError: its conversion is not in the store any more.
        DatasetError: a file of the conversion is damaged.
    """
    ingestion = store.ingestion_of(episode)
    made = store.conversion(ingestion.conversion) if ingestion else None
    if ingestion is None or made is None or made.result is None:
        raise StoreError("its conversion is not in the store", where=f"episode {episode.id}",
                         mend="ingest the log again: hardcase ingest LOG --map MAP")
    number = ingestion.episodes.index(episode.id)
    frames = FrameFile(store.blob(made.files[FRAMES]), made.result)
    shown = of_table(episode, frames.table(number))
    found: dict[str, Pictures] = {}
    for name in made.result.cameras:
        if CAMERA + name not in made.files:
            continue
        images, used = Images(store.blob(made.files[CAMERA + name])), frames.images(number, name)
        at = np.flatnonzero(np.diff(used, prepend=-1) != 0)  # a frame that still uses the image before draws nothing
        at = at[used[at] >= 0]
        found[name] = Pictures(shown.seconds[at], tuple(images[int(k)] for k in used[at]))
    return replace(shown, pictures=found)
