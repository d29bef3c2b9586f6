"""What may go and what stays."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import StoreError
from pipeline.store.caches import cache_folder, lerobot_copies
from pipeline.store.gc import GRACE_S, collect, unreferenced


def age(path: Path, seconds: float = 2 * GRACE_S) -> Path:
    then = time.time() - seconds
    for p in [path, *path.rglob("*")]:
        os.utime(p, (then, then), follow_symlinks=False)
    return path


def litter(store) -> set[Path]:
    """One of everything that a killed or a superseded step leaves behind."""
    root = store.root
    (root / "versions/0123456789abcdef/data").mkdir(parents=True)
    (root / "versions/0123456789abcdef/data/file.parquet").write_bytes(b"x" * 1000)
    (root / "policies/fedcba9876543210").mkdir(parents=True)
    (root / "tmp/building").mkdir()
    (root / "tmp/tmpabc").write_bytes(b"half")
    (root / "versions/.0123456789abcdef.x8f3_k2a").write_bytes(b"half")
    return {
        store.blob(store.put_blob(b"nobody wants me")),
        root / "versions/0123456789abcdef",
        root / "policies/fedcba9876543210",
        root / "tmp/building",
        root / "tmp/tmpabc",
        root / "versions/.0123456789abcdef.x8f3_k2a",
    }


def test_only_what_no_row_mentions_is_listed_and_deleted(store, small):
    small.lap(store)
    with store.lease(small.run) as lease, store.commit(lease) as tx:
        tx.finish_step(0, "exam", outputs={"results": store.put_blob(b"exam results"), "n": 400})
    wanted = litter(store)
    age(store.root)
    garbage = unreferenced(store)
    assert {p.path for p in garbage.pieces} == wanted
    assert all(path.exists() for path in wanted), "listing deletes nothing"
    assert {p.bytes for p in garbage.pieces if p.path.name == "tmpabc"} == {4}
    assert collect(store, garbage) == garbage.bytes > 1000
    assert not any(path.exists() for path in wanted)
    assert store.verify() == []
    assert store.query("SELECT count(*) FROM step") == [(8,)]
    assert unreferenced(store).pieces == ()


def test_what_is_young_is_left_alone_unless_told(store, small):
    small.lap(store)
    wanted = litter(store)
    garbage = unreferenced(store)
    assert (garbage.pieces, garbage.young) == ((), len(wanted))
    assert {p.path for p in unreferenced(store, grace_s=0).pieces} == wanted


def test_storing_old_garbage_again_makes_it_young(store):
    age(store.blob(store.put_blob(b"result")))
    assert len(unreferenced(store).pieces) == 1
    store.put_blob(b"result")
    assert unreferenced(store).pieces == ()


def test_links_are_neither_followed_nor_deleted(store, tmp_path):
    outside = tmp_path / "precious"
    outside.mkdir()
    (outside / "thesis.txt").write_text("years of work")
    (store.root / "versions/link").symlink_to(outside)
    (store.root / "tmp/folder").mkdir()
    (store.root / "tmp/folder/link").symlink_to(outside)
    (store.root / "releases").symlink_to(outside)
    age(store.root)
    collect(store, unreferenced(store, grace_s=0))
    assert (outside / "thesis.txt").read_text() == "years of work"
    assert (store.root / "versions/link").is_symlink()
    assert not (store.root / "tmp/folder").exists()


def test_nothing_is_collected_under_a_running_loop(store, small):
    age(store.blob(store.put_blob(b"nobody wants me")))
    garbage = unreferenced(store)
    with (
        store.lease(small.run, holder="hardcase loop"),
        pytest.raises(StoreError, match=r"a loop uses(.|\n)*hardcase gc"),
    ):
        collect(store, garbage)
    assert collect(store, garbage) == len(b"nobody wants me")


def test_what_was_mentioned_since_the_listing_stays(store, small):
    age(store.blob(store.put_blob(small.recording(0))))
    garbage = unreferenced(store)
    small.lap(store)
    assert collect(store, garbage) == 0
    assert store.verify() == []


LOAD = """
import sys
from datasets import Dataset
for path in sys.argv[1:]:
    print(len(Dataset.from_parquet([path])))
"""


def test_copies_that_lerobot_makes_at_a_load_are_found_and_made_again(store, tmp_path, monkeypatch):
    columns = ("episode_index", "frame_index", "index", "task_index", "timestamp")
    pq.write_table(pa.table({"action": [0.5, 1.0]} | {c: [0, 1] for c in columns}), tmp_path / "frames.parquet")
    pq.write_table(pa.table({"text": ["somebody else's data"]}), tmp_path / "other.parquet")
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hf"))
    monkeypatch.delenv("HF_DATASETS_CACHE", raising=False)

    def load() -> str:
        files = [str(tmp_path / "frames.parquet"), str(tmp_path / "other.parquet")]
        return subprocess.run(
            [sys.executable, "-c", LOAD, *files],
            check=True,
            capture_output=True,
            text=True,
            env=os.environ | {"HF_HUB_OFFLINE": "1"},
        ).stdout

    assert load() == "2\n1\n"
    copies = [p for p in lerobot_copies(cache_folder()) if p.is_dir()]
    assert len(copies) == 1 and list(copies[0].glob("*/*/*.arrow"))
    collect(store, unreferenced(store, caches=[cache_folder()], grace_s=0))
    assert list(lerobot_copies(cache_folder())) == []
    assert len(list(cache_folder().glob("parquet/default-*"))) == 1, "another program's copy stays"
    assert load() == "2\n1\n"


def test_a_machine_without_such_a_cache_has_nothing_to_collect(store, tmp_path):
    assert unreferenced(store, caches=[tmp_path / "none"]).pieces == ()
