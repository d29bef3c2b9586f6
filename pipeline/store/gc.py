"""Garbage: what nothing in the catalog refers to, videos of no version, and copies that can be made again."""

import os
import re
import shutil
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import StoreError
from pipeline.store.caches import lerobot_copies
from pipeline.store.folder import explain, shas_in
from pipeline.store.store import Store
from pipeline.store.videos import linked, spare

GRACE_S = 3600.0
"""Age below which nothing is garbage [s]: a running step writes files before the row that mentions them."""

FOLDERS = ("versions", "policies", "releases")
BROWSE = "browse"
"""Recordings for browsing, made again when they are asked for; see pipeline.browsing.cache."""
TABLES = ("run", "invocation", "step", "policy", "episode", "version", "verdict", "release", "hard_case",
          "raw_log", "conversion", "ingestion")  # not `erasure`: what it names is to go

_FOLDER = re.compile(rf"(?:{'|'.join(FOLDERS)})/[^/\"\\]+")
_TEMPORARY = re.compile(r"\..+\.[a-z0-9_]{8}")  # as pipeline.files.atomic names them


@dataclass(frozen=True, slots=True)
class Piece:
    """One thing to delete."""

    path: Path
    kind: str
    bytes: int


@dataclass(frozen=True, slots=True)
class Garbage:
    """What could be deleted, and how much was passed over because it is young."""

    pieces: tuple[Piece, ...]
    young: int

    @property
    def bytes(self) -> int:
        """Space that deleting gives back."""
        return sum(p.bytes for p in self.pieces)


def unreferenced(store: Store, *, caches: Iterable[Path] = (), grace_s: float = GRACE_S) -> Garbage:
    """List blobs, version and policy folders that no row mentions, leftovers of killed writers, and lerobot's copies.

    A blob is kept when its sha256 stands anywhere in the catalog, in the outputs of a step as well. Links are
    neither followed nor listed. Nothing is deleted.

    Args:
        store: an open store.
        caches: Hugging Face `datasets` cache folders to look into, see `pipeline.store.caches.cache_folder`.
        grace_s: age below which a thing is left alone [s].
    """
    try:
        found = [*_candidates(store, *_mentioned(store)), *_copies(caches)]
        now = time.time()
        old = [p for p in found if now - _newest(p.path) >= grace_s]
    except OSError as error:
        raise explain(error, store.root) from error
    return Garbage(tuple(sorted(old, key=lambda p: (p.kind, p.path))), len(found) - len(old))


def collect(store: Store, garbage: Garbage) -> int:
    """Delete what was listed, except what a row mentions by now.

    Returns:
        Bytes given back.

    Raises:
        StoreError: a loop runs on this store, or something cannot be deleted.
    """
    if who := store.holder():
        raise StoreError(
            f"a loop uses this store: {who}", where=store.root, mend="collect once it has ended: hardcase gc"
        )
    freed = 0
    with store.exclusive():
        blobs, folders = _mentioned(store)
        for piece in garbage.pieces:
            if piece.path.name in blobs or f"{piece.path.parent.name}/{piece.path.name}" in folders:
                continue
            if piece.path.suffix == ".mp4" and piece.path.exists() and linked(piece.path):
                continue
            try:
                _delete(piece.path)
            except OSError as error:
                raise explain(error, piece.path) from error
            freed += piece.bytes
    return freed


def _mentioned(store: Store) -> tuple[set[str], set[str]]:
    """Every sha256 and every folder (`versions/x`) that stands in some row."""
    blobs: set[str] = set()
    folders: set[str] = set()
    for table in TABLES:
        for (text,) in store.query(f"SELECT json FROM {table}"):
            blobs |= shas_in(str(text))
            folders.update(_FOLDER.findall(str(text)))
    return blobs, folders


def _candidates(store: Store, blobs: set[str], folders: set[str]) -> Iterator[Piece]:
    for entry in _entries(store.root / "blobs"):
        if entry.name not in blobs:
            yield _piece(entry.path, "blob")
    for name in FOLDERS:
        for entry in _entries(store.root / name):
            if f"{name}/{entry.name}" not in folders:
                yield _piece(entry.path, "temporary" if _TEMPORARY.fullmatch(entry.name) else name)
            else:
                yield from _leftovers(Path(entry.path))
    for path in spare(store.root):
        yield _piece(str(path), "video" if path.suffix != ".npy" else "decoded frames")
    for entry in _entries(store.root / "tmp"):
        yield _piece(entry.path, "temporary")
    for entry in _entries(store.root / BROWSE):
        yield _piece(entry.path, "temporary" if _TEMPORARY.fullmatch(entry.name) else "browsing")
    for entry in _entries(store.root):
        if _TEMPORARY.fullmatch(entry.name):
            yield _piece(entry.path, "temporary")


def _leftovers(folder: Path) -> Iterator[Piece]:
    for at, _, names in os.walk(folder):
        for name in names:
            if _TEMPORARY.fullmatch(name) and not (Path(at) / name).is_symlink():
                yield _piece(os.path.join(at, name), "temporary")  # noqa: PTH118


def _copies(caches: Iterable[Path]) -> Iterator[Piece]:
    for cache in caches:
        for copy in lerobot_copies(cache):
            yield _piece(str(copy), "lerobot cache")


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    """What a folder holds, links left out; nothing for a link or what is no folder."""
    if folder.is_symlink() or not folder.is_dir():
        return []
    with os.scandir(folder) as entries:
        return [e for e in entries if not e.is_symlink()]


def _piece(path: str, kind: str) -> Piece:
    return Piece(Path(path), kind, sum(s.st_size for s in _stats(Path(path))))


def _newest(path: Path) -> float:
    return max(s.st_mtime for s in _stats(path))


def _stats(path: Path) -> Iterator[os.stat_result]:
    yield path.lstat()
    if path.is_dir() and not path.is_symlink():
        for at, folders, names in os.walk(path):
            for name in (*folders, *names):
                yield (Path(at) / name).lstat()


def _delete(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)  # links inside are removed, never followed
    else:
        path.unlink(missing_ok=True)
