"""Where the recordings of sessions go: into the store, also those that a killed session left."""

import sys
from pathlib import Path

from mcap.reader import make_reader

from pipeline.files import sha256_file
from pipeline.recording.live import Closed
from pipeline.recording.metadata import NAME
from pipeline.recording.recover import recover
from pipeline.store import Lease, Store
from schemas.episode import Episode

FOLDER = "recordings"
"""Where recordings grow, relative to the store's root."""


def keep(store: Store, lease: Lease, closed: Closed) -> None:
    """Move a recording into the store, and its episode into the catalog."""
    store.put_blob(closed.path)
    with store.commit(lease, lease.run) as tx:
        tx.add_episodes([closed.episode])
    closed.path.unlink()  # only now: a kill before this line leaves both, and the next session keeps it again


def adopt(store: Store, lease: Lease) -> list[Episode]:
    """Recover what a killed session left, and keep it; each is told on standard error.

    Raises:
        HardcaseError: the disk refuses.
    """
    folder = store.root / FOLDER
    if not folder.is_dir():
        return []
    recover(folder)
    found: list[Episode] = []
    for path in sorted(folder.glob("*.mcap")):
        episode = _episode(path)
        if episode is not None:
            keep(store, lease, Closed(path, episode, {}))
            print(f"kept what an earlier session left: episode {episode.id}, {episode.duration_s:.1f} s, "
                  f"label {episode.outcome.label}", file=sys.stderr)
            found.append(episode)
    return found


def _episode(path: Path) -> Episode | None:
    """The episode that a whole recording of ours tells of; None where it tells none."""
    with path.open("rb") as stream:
        for record in make_reader(stream).iter_metadata():
            if record.name == NAME:
                episode = Episode.model_validate_json(record.metadata["episode_json"])
                return episode.model_copy(update={"blob": sha256_file(path)})
    return None
