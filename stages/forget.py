"""Forget: an episode and everything that holds it leave the store, so that no byte of them is found again.

Every step can be done twice: whoever was killed at any point is finished by the next call with the same erasure. The
order is: what goes is written down, shared files are written anew beside the old ones, the rows go in one commit, then
files, then what the catalog remembers of deleted rows.
"""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import StoreError
from pipeline.files import sha256_file, sync_folder
from pipeline.lerobot_view.clips import FOLDER as VIDEOS
from pipeline.lerobot_view.erasing import Loss, erase, holds, lost_videos
from pipeline.redaction.statement import sign_again
from pipeline.shards import read_shard, write_shard
from pipeline.store import Lease, Store
from pipeline.store.caches import lerobot_copies
from pipeline.store.folder import FaultPoint, explain, no_fault
from pipeline.store.in_use import writers
from schemas.dataset import DatasetVersion
from schemas.erasure import Erasure

CACHES = ("browse", "caches")
"""Folders of a store that hold nothing but copies, made again when they are asked for."""
LEFT = ("recordings", "quarantine")
"""Folders where a killed session may have left a file that the store has too."""
ASIDE = "erasure"


@dataclass(frozen=True, slots=True)
class Forgotten:
    """What is done."""

    erasure: Erasure
    freed: int
    """Bytes of files that were deleted."""
    versions: tuple[DatasetVersion, ...]
    """The versions that lost episodes, as they are now."""


def forget(store: Store, lease: Lease, erasure: Erasure, *, caches: Iterable[Path] = (),
           fault: FaultPoint = no_fault, progress: Callable[[str], None] = lambda name: None) -> Forgotten:
    """Erase what was planned; the store's lease is held meanwhile.

    Args:
        store: where it is.
        lease: of this erasure, taken with `erases`.
        erasure: see `plan_erasure`, or one that was ordered before and cut off.
        caches: Hugging Face `datasets` cache folders, whose copies of LeRobot datasets go.
        fault: for tests of crashes.
        progress: told what is done now, in a few words.

    Raises:
        StoreError: somebody writes in the store, the disk is full, or a file cannot be deleted.
        DatasetError: a version was changed after it was built.
    """
    if busy := writers(store.tmp):
        raise StoreError(f"something is being written in the store: {busy[0]}", where=store.tmp,
                         mend="wait for it, or end it; then forget again")
    if not store.erased([erasure.episode]):
        store.order_erasure(lease, erasure)
    progress("shards and versions are written anew")
    shards = dict(_shards(store, erasure, fault))
    versions = _versions(store, erasure, shards, fault)
    store.strike(lease, erasure, shards, versions)
    progress("files are deleted")
    freed = sum(store.erase_blob(sha) for sha in (*erasure.blobs, *erasure.shards))
    sync_folder(store.root / "blobs")
    freed += sum(_delete(path, fault) for path in (*_copies(store, erasure), *_caches(caches)))
    progress("the catalog is cleaned")
    store.finish_erasure(lease, erasure)
    return Forgotten(erasure, freed, tuple(versions))


def _shards(store: Store, erasure: Erasure, fault: FaultPoint) -> Iterator[tuple[str, str]]:
    """Hash of each shard -> its hash without the erased variants; none once the rows speak of the new ones."""
    for sha in erasure.shards:
        if not store.query("SELECT 1 FROM episode WHERE blob = ? LIMIT 1", (sha,)):
            continue
        kept = {id: frames for id, frames in read_shard(store.blob(sha)).items() if id not in erasure.episodes}
        path = store.tmp / ASIDE / f"{sha}.arrow"
        fault("write shard")
        write_shard(path, kept)
        yield sha, store.put_blob(path, move=True)


def _versions(store: Store, erasure: Erasure, shards: Mapping[str, str], fault: FaultPoint) -> list[DatasetVersion]:
    """The versions without the episodes."""
    loss = Loss(frozenset(erasure.episodes), frozenset((*erasure.blobs, *erasure.shards)), shards)
    done: list[DatasetVersion] = []
    for id in erasure.versions:
        fault("write version")
        done.append(erase(store.path(store.version(id).path), loss, store.tmp / ASIDE,
                          lambda new, known, said, old: sign_again(new, known, said, store=store.root, old=old)))
    return done


def _copies(store: Store, erasure: Erasure) -> Iterator[Path]:
    """Everything below the store's root that is no blob, version or policy of the catalog and may hold the episode."""
    ids = {id.encode() for id in (*erasure.episodes, *erasure.hard_cases)}
    for page in _files(store.root / "reports"):
        if page.stem in erasure.runs or any(id in page.read_bytes() for id in ids):
            yield page
    gone = {*erasure.blobs, *erasure.shards, *erasure.raw_logs}
    for name in LEFT:
        yield from (path for path in _files(store.root / name) if sha256_file(path) in gone)
    yield from (store.root / name for name in CACHES if (store.root / name).exists())
    yield from lost_videos(store.root / VIDEOS, gone)
    yield from _strays(store, erasure)
    yield from sorted(store.tmp.iterdir())


def _strays(store: Store, erasure: Erasure) -> Iterator[Path]:
    """Version folders without a row, which a killed build left, if they hold the episode or cannot say."""
    rows = {str(id) for (id,) in store.query("SELECT id FROM version")}
    for folder in sorted((store.root / "versions").iterdir()):
        if folder.name not in rows and not folder.is_symlink() and holds(folder, erasure.episodes):
            yield folder


def _caches(caches: Iterable[Path]) -> Iterator[Path]:
    for cache in caches:
        yield from lerobot_copies(cache)


def _files(folder: Path) -> list[Path]:
    if folder.is_symlink() or not folder.is_dir():
        return []
    return sorted(p for p in folder.rglob("*") if p.is_file() and not p.is_symlink())


def _delete(path: Path, fault: FaultPoint) -> int:
    """Take a file or folder away; links inside are removed, never followed."""
    fault("delete copy")
    try:
        if path.is_dir() and not path.is_symlink():
            size = sum(p.lstat().st_size for p in path.rglob("*") if not p.is_dir())
            shutil.rmtree(path)
        else:
            size = path.lstat().st_size
            path.unlink()
        sync_folder(path.parent)
    except FileNotFoundError:
        return 0
    except OSError as error:
        raise explain(error, path) from error
    return size
