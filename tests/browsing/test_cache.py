"""Recordings for browsing are made once, go when they should, and are never found half written."""

import pytest

from flows.browse.making import Making
from pipeline.browsing.cache import Cache
from pipeline.store.gc import collect, unreferenced
from stages.forget import CACHES


def test_what_was_made_is_taken_from_the_cache(shelf, store):
    made = Making(store).episode(shelf.demonstrations[1])
    before = {path: path.read_bytes() for path in made.entry.layers.values()}
    again = Making(store).episode(shelf.demonstrations[1])
    assert again == made
    assert {path: path.read_bytes() for path in again.entry.layers.values()} == before  # Rerun would number rows anew


def test_another_label_makes_another_layer(shelf, store):
    cache, episode = Cache(store.root), shelf.demonstrations[0]
    changed = episode.model_copy(update={"outcome": episode.outcome.model_copy(update={"reason": "seen twice"})})
    assert cache.place(episode, "labels") != cache.place(changed, "labels")
    assert cache.place(episode, "labels") != cache.place(episode, "base")


def test_what_fails_on_the_way_leaves_nothing(tmp_path):
    cache = Cache(tmp_path)
    with pytest.raises(ZeroDivisionError), cache.making(cache.folder / "a.rrd") as part:
        part.write_bytes(b"half")
        raise ZeroDivisionError
    assert list(cache.folder.iterdir()) == []


def test_gc_takes_them_away_and_they_are_made_again(shelf, store):
    Making(store).episode(shelf.failure)
    garbage = unreferenced(store, grace_s=0)
    assert {p.kind for p in garbage.pieces} == {"browsing"}
    collect(store, garbage)
    assert list((store.root / "browse").iterdir()) == []
    made = Making(store).episode(shelf.failure)
    assert all(path.is_file() for path in made.entry.layers.values())


def test_whoever_forgets_an_episode_deletes_the_folder(store):
    assert Cache(store.root).folder.name in CACHES
