"""The folder under a store: where it is, whether a database may live there, and what its errors mean."""

import errno
import os
import re
import sqlite3
from collections.abc import Callable
from pathlib import Path

from pipeline.errors import StoreError

type FaultPoint = Callable[[str], None]
"""Called with a name just before every fsync, rename and commit; tests end the process or raise from it."""

MOUNTS = Path("/proc/self/mountinfo")
RESERVE_MB = 200
ELSEWHERE = "HARDCASE_STORE=/a/local/folder"

# SQLite's WAL needs memory that processes share, which none of these give (https://sqlite.org/wal.html).
NETWORK = frozenset({
    "9p", "afs", "beegfs", "ceph", "cifs", "coda", "drvfs", "fuse.ceph", "fuse.glusterfs", "fuse.rclone", "fuse.s3fs",
    "fuse.sshfs", "gfs2", "glusterfs", "gpfs", "lustre", "ncpfs", "nfs", "nfs4", "ocfs2", "orangefs", "smb3", "smbfs",
})  # fmt: skip
FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
DENIED = frozenset({errno.EROFS, errno.EACCES, errno.EPERM})

_PREFIX = re.compile(r"[0-9a-f]{8,16}")
_SHORT = re.compile(r"[0-9a-f]{16}")
_SHA = re.compile(r"(?<![0-9a-f])[0-9a-f]{64}(?![0-9a-f])")
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


def store_root() -> Path:
    """The store that HARDCASE_STORE names, else `datasets/store` below the current folder."""
    return Path(os.environ.get("HARDCASE_STORE") or "datasets/store")


def no_fault(name: str) -> None:
    """The fault point of everyday use: nothing happens."""


def check_id(kind: str, value: str) -> str:
    """A 16-digit hex id, or an error; nothing else ever becomes part of a path or a query."""
    return _check(_SHORT, kind, value, "an id has 16 hex digits; `hardcase why ID` takes the first 8 or more")


def check_prefix(value: str, given: str = "") -> str:
    """An id or its first 8 digits and more, or an error; `given` says where it was typed."""
    return _check(
        _PREFIX,
        "id",
        value,
        "give 8 to 16 hex digits of the id of a policy, version, episode, verdict, hard case or run",
        given,
    )


def check_sha(value: str) -> str:
    """The name of a blob: 64 hex digits, or an error."""
    return _check(_SHA, "blob", value, "a blob is named by the 64 hex digits of its sha256")


def shas_in(text: str) -> set[str]:
    """Everything in a text that could be the name of a blob."""
    return set(_SHA.findall(text))


def check_name(kind: str, value: str) -> str:
    """A name of lower-case letters, digits, - and _, or an error."""
    return _check(_NAME, kind, value, "use 1 to 64 of a-z, 0-9, - and _, the first a letter or digit")


def _check(pattern: re.Pattern[str], kind: str, value: str, mend: str, given: str = "") -> str:
    if pattern.fullmatch(value) is None:
        raise StoreError(f"not a valid {kind}: {value[:80]!r}", where=given or f"the {kind} given", mend=mend)
    return value


def inside(root: Path, relative: str) -> Path:
    """The path of something in the store, refused when it leads out of it, by `..`, a link or otherwise."""
    path = root / relative
    base = root.resolve()
    if "\0" in relative or Path(relative).is_absolute() or base not in path.resolve().parents:
        raise StoreError(
            f"path {relative!r} leads out of the store",
            where=root,
            mend="store paths are relative and stay below the root",
        )
    return path


def file_system(path: Path, mounts: Path = MOUNTS) -> str:
    """Type of the file system that holds an existing path ('ext4', 'nfs4', ...); '' where the system does not tell.

    Source: proc_pid_mountinfo(5).
    """
    if not mounts.exists():
        return ""
    best, found = -1, ""
    target = str(path.resolve())
    for line in mounts.read_text(errors="replace").splitlines():
        before, _, after = line.partition(" - ")
        point = re.sub(r"\\([0-7]{3})", lambda m: chr(int(m[1], 8)), before.split(" ")[4])
        holds = target == point or target.startswith(point.rstrip("/") + "/")
        if holds and len(point) >= best:  # a later mount on the same point hides the earlier one
            best, found = len(point), after.split(" ")[0]
    return found


def refuse_network(root: Path, mounts: Path = MOUNTS) -> None:
    """A catalog on a network file system would lose commits: refuse it before anything is written.

    Raises:
        StoreError: the folder lies on one of NETWORK.
    """
    kind = file_system(root, mounts)
    if kind in NETWORK:
        raise StoreError(
            f"the store lies on a network file system ({kind})",
            where=root,
            mend=f"name a folder on a local disk: {ELSEWHERE}",
        )


def refuse_low_space(root: Path, reserve_mb: int) -> None:
    """Refuse to start when less than the reserve is free, rather than to fail half-way.

    Raises:
        StoreError: fewer than `reserve_mb` megabytes (10^6 bytes) are free for this user.
    """
    disk = os.statvfs(root)
    free_mb = disk.f_bavail * disk.f_frsize // 1_000_000
    if free_mb < reserve_mb:
        raise StoreError(
            f"{free_mb} MB free, {reserve_mb} MB are kept in reserve",
            where=root,
            mend=f"free some space (hardcase gc shows what can go), or name another folder: {ELSEWHERE}",
        )


def is_full(error: OSError | sqlite3.Error) -> bool:
    """Whether a write failed for want of space: disk, quota or file size limit."""
    if isinstance(error, OSError):
        return error.errno in FULL
    return getattr(error, "sqlite_errorname", "") in {"SQLITE_FULL", "SQLITE_IOERR_WRITE"}


def explain(error: OSError | sqlite3.Error, where: object) -> StoreError:
    """What a file or database error means to a person, and the mend."""
    name = getattr(error, "sqlite_errorname", "")
    if is_full(error):
        return StoreError(
            "no space left for the store; nothing of this step was recorded",
            where=where,
            mend="free some space (hardcase gc shows what can go), then: hardcase loop --resume",
        )
    if name in {"SQLITE_CORRUPT", "SQLITE_NOTADB"}:
        return StoreError(
            f"the catalog is damaged ({error})",
            where=where,
            mend=f"put back a copy of catalog.db, or begin in another folder: {ELSEWHERE}; blobs are not affected",
        )
    if name.startswith("SQLITE_READONLY") or (isinstance(error, OSError) and error.errno in DENIED):
        return StoreError(
            "the store cannot be written",
            where=where,
            mend=f"give yourself write permission, or name another folder: {ELSEWHERE}",
        )
    if name.startswith("SQLITE_BUSY"):
        return busy(where)
    return StoreError(
        f"the store failed: {error}",
        where=where,
        mend="see the disk with `hardcase doctor`, then: hardcase loop --resume",
    )


def busy(where: object) -> StoreError:
    """Somebody else has been writing for too long."""
    return StoreError(
        "another process has held the store's write lock for too long",
        where=where,
        mend="see who: fuser -v catalog.lock; end or continue that process, then: hardcase loop --resume",
    )
