"""Files that are whole or absent, and hashes of what they hold."""

import hashlib
import os
import secrets
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import Path
from typing import IO


@contextmanager
def atomic(path: Path) -> Generator[IO[bytes]]:
    """Write all of `path` or none of it: readers never see half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    with part.open("xb") as stream:  # not tempfile: what it makes nobody else may read, whatever the umask says
        try:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())  # the name must not outlive a power cut its bytes did not
            part.replace(path)
            sync_folder(path.parent)
        except BaseException:
            part.unlink(missing_ok=True)
            raise


def sync_folder(folder: Path) -> None:
    """Make renames inside `folder` durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sha256(data: bytes) -> str:
    """Hex digest of bytes."""
    return hashlib.sha256(data).hexdigest()


def sha256_file(path: Path) -> str:
    """Hex digest of a file, read in blocks."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def short_id(*parts: object) -> str:
    """First 16 hex digits of the sha256 over the parts' text, each ended by a zero byte."""
    return sha256(b"".join(str(p).encode() + b"\0" for p in parts))[:16]


def source_hash(files: Iterable[Path]) -> str:
    """One hash over source files, by name and content, in sorted order; comments count."""
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
