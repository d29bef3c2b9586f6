"""Episodes of imported datasets as they are drawn: values under the names that a version of theirs gives them."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, to_rows
from pipeline.browsing.attempts import of_table
from pipeline.browsing.shown import Shown
from pipeline.errors import DatasetError, StoreError
from pipeline.frames import FeatureTable
from pipeline.lerobot_view.layout import INFO
from pipeline.store import Store
from schemas.episode import Episode


def imported(store: Store, episode: Episode) -> Shown:
    """What is drawn of an imported episode.

    Raises:
        StoreError: no version holds it any more, so that nobody knows what its values are called.
        DatasetError: its frames are damaged.
    """
    rows = store.query("SELECT version.json ->> '$.path' FROM version_episode JOIN version ON version.id = version"
                       " WHERE episode = ? ORDER BY version.place LIMIT 1", (episode.id,))
    if not rows or episode.blob is None:
        raise StoreError("no dataset version holds it", where=f"episode {episode.id}",
                         mend="import its dataset again: hardcase import FOLDER")
    declared: dict[str, Any] = json.loads((store.path(str(rows[0][0])) / INFO).read_text())["features"]
    file = store.blob(episode.blob)
    try:
        table = pa.ipc.open_file(pa.memory_map(str(file))).read_all().combine_chunks()
        values: dict[str, NDArray[np.float32]] = {}
        for name in table.column_names:
            column = table.column(name).chunk(0)
            width = getattr(column.type, "list_size", 1)
            values[name] = np.asarray(to_rows(column, width), np.float32)
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:
        raise DatasetError("its frames are damaged", where=file,
                           mend="import its dataset again: hardcase import FOLDER") from error
    names = {name: _names(declared.get(name, {}).get("names"), rows.shape[1]) for name, rows in values.items()}
    return of_table(episode, FeatureTable(names, values))


def _names(told: object, width: int) -> tuple[str, ...]:
    """Names of a feature's values: a list, a mapping with one list, or their numbers."""
    found: list[Any] = []
    if isinstance(told, dict):
        found = next((list(v) for v in told.values() if isinstance(v, list)), [])  # pyright: ignore
    elif isinstance(told, list):
        found = list(told)  # pyright: ignore[reportUnknownArgumentType]
    return tuple(str(n) for n in found) if len(found) == width else tuple(str(k) for k in range(width))
