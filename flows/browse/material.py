"""Episodes out of the store as they are drawn, whatever they are made of."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from flows.browse.imported import imported
from flows.browse.ingested import ingested
from pipeline.browsing.attempts import of_frames, of_trace
from pipeline.browsing.recording import of_recording
from pipeline.browsing.shown import Shown
from pipeline.errors import RecordingError, StoreError
from pipeline.frames import Frames
from pipeline.protocols import Policy
from pipeline.recording import read_attachments, read_frames
from pipeline.shards import read_shard
from pipeline.store import Store
from pipeline.trace import Rows, Shadow
from schemas.episode import VARIANTS, Episode


class Showing:
    """Reads episodes of one store.

    Args:
        store: where they are.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._shard = lru_cache(maxsize=4)(lambda blob: read_shard(store.blob(blob)))
        self._attached = lru_cache(maxsize=64)(lambda blob: read_attachments(store.blob(blob)))

    def episode(self, episode: Episode) -> tuple[Shown, Mapping[str, Shadow]]:
        """What is drawn of an episode, and the shadow policies that were recorded with it.

        Raises:
            HardcaseError: its recording is gone, damaged, or of a kind that cannot be read.
        """
        if episode.origin in VARIANTS:
            return of_frames(episode, self._variant(episode), self._of_parent(episode)), {}
        if episode.origin == "ingested":
            return ingested(self._store, episode), {}
        if episode.origin == "imported":
            return imported(self._store, episode), {}
        shown, opened = of_recording(self._store.blob(_blob(episode)), episode)
        topics = opened.decoder.topics
        watched = opened.decoder.trace().shadows if any(t.startswith("/policy/") for t in topics) else {}
        return shown, watched

    def observed(self, episode: Episode) -> tuple[Rows, Rows] | None:
        """What a policy of the arm saw at every tick: state (m, 16) and environment (m, 7); None for other robots."""
        if episode.scene.family == "foreign":
            return None
        if episode.origin in VARIANTS:
            frames = self._variant(episode)
        else:
            try:
                frames = read_frames(self._store.blob(_blob(episode)))[1]
            except RecordingError:
                return None  # a robot with other joints; what cannot be read at all was refused before
        return frames.state.astype(np.float64), frames.environment.astype(np.float64)

    def remade(self, variant: Episode) -> Shown:
        """A variant made again from its parent, draws and seed, bit for bit."""
        from stages.augment import remake

        parent = self._store.episode(str(variant.parent))
        frames = remake(variant, (parent, read_frames(self._store.blob(_blob(parent)))[1]))
        return of_frames(variant, frames, self._of_parent(variant))

    def played(self, episode: Episode, policies: Mapping[str, Policy]) -> dict[str, Shown]:
        """Policies at the scene of an episode, in simulation."""
        from stages.browse import play_beside

        found = play_beside(episode, policies)
        return {name: replace(of_trace(p.episode, p.trace, p.attached), title=f"{name}: {p.episode.outcome.label}",
                              facts=f"### {name}\n\n{p.episode.outcome.label} after {len(p.trace) / p.trace.hz:.1f} s,"
                                    " in simulation with the drawn physics of the scene, or nominal ones")
                for name, p in found.items()}

    def _variant(self, episode: Episode) -> Frames:
        if episode.blob is not None:
            return self._shard(episode.blob)[episode.id]
        from stages.augment import remake

        parent = self._store.episode(str(episode.parent))
        return remake(episode, (parent, read_frames(self._store.blob(_blob(parent)))[1]))

    def _of_parent(self, episode: Episode) -> Mapping[str, bytes]:
        return self._attached(_blob(self._store.episode(str(episode.parent))))


def _blob(episode: Episode) -> str:
    if episode.blob is None:
        raise StoreError("the store keeps no recording of it", where=f"episode {episode.id}",
                         mend=f"see what is known of it: hardcase why {episode.id}")
    return episode.blob
