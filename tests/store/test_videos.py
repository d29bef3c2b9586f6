"""Videos and decoded frames: gc takes what no version needs, and whoever forgets a recording finds what shows it."""

import os
import time

from pipeline.lerobot_view.clips import Clip, Clips
from pipeline.lerobot_view.pixels import empty
from pipeline.store.gc import GRACE_S, collect, unreferenced
from pipeline.store.videos import showing


def put(store, name, blob):
    """A video as an encoder would leave it, made of pictures in a blob; its content does not matter here."""
    part = store.root / "tmp" / name
    part.write_bytes(name.encode())
    return Clips(store.root).add(part, Clip(part, "", name * 8, f"{blob} uses", 48, 64, 3, empty()))


def frames_of(store, clip):
    (store.root / "caches/frames").mkdir(parents=True, exist_ok=True)
    file = store.root / "caches/frames" / f"{clip.sha256}.npy"
    file.write_bytes(b"decoded")
    return file


def note(store, clip):
    return store.root / "videos" / f"{clip.key}.json"


def test_gc_takes_videos_of_no_version_and_what_can_be_decoded_again(store):
    used, spare = put(store, "used", "a" * 64), put(store, "spare", "b" * 64)
    os.link(used.file, store.root / "link")
    decoded = frames_of(store, used)
    assert unreferenced(store).pieces == (), "all of it is young"
    then = time.time() - 2 * GRACE_S
    for path in (used.file, spare.file, decoded, note(store, used), note(store, spare)):
        os.utime(path, (then, then))
    garbage = unreferenced(store)
    assert {p.path for p in garbage.pieces} == {spare.file, note(store, spare), decoded}
    os.link(spare.file, store.root / "later")  # a version takes it after it was listed
    collect(store, garbage)
    assert spare.file.exists() and used.file.exists() and not decoded.exists()


def test_what_shows_a_recording_is_found_by_the_recordings_hash(store):
    one, other = put(store, "one", "a" * 64), put(store, "other", "b" * 64)
    decoded = frames_of(store, one)
    frames_of(store, other)
    assert set(showing(store.root, {"a" * 64})) == {one.file, note(store, one), decoded}
    assert showing(store.root, {"c" * 64}) == []
