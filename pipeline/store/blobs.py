"""Blobs: read-only files named by the sha256 of their bytes.

What reaches the disk when: the bytes of a blob before its name (fsync, then rename), its name before the first
catalog row that mentions it (`Blobs.settle`, called within the commit). A blob that no row mentions may be lost
in a power cut, and nobody misses it.
"""

import errno
import hashlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import mkstemp
from typing import IO

from pipeline.errors import StoreError
from pipeline.files import sha256, sha256_file, sync_folder
from pipeline.store.folder import FaultPoint, check_sha, explain, no_fault

BLOCK = 1 << 20


class Blobs:
    """The `blobs` folder of a store; safe for any number of processes at once, with no lock."""

    def __init__(self, root: Path, fault: FaultPoint = no_fault,
                 refuse: Callable[[str], None] = lambda sha: None) -> None:
        self.folder, self._tmp, self._fault, self._refuse = root / "blobs", root / "tmp", fault, refuse

    def path(self, sha: str) -> Path:
        """Where a blob is, or would be.

        Raises:
            StoreError: `sha` is not 64 hex digits.
        """
        return self.folder / check_sha(sha)

    def put(self, source: bytes | Path, *, move: bool = False) -> str:
        """Take bytes, or a copy of a file (`move`: the file itself), in; the same bytes are stored once.

        Returns:
            The sha256, by which `get` finds the bytes again.

        Raises:
            StoreError: no space, or the source cannot be read; nothing half-written is ever visible.
        """
        try:
            return self._put_bytes(source) if isinstance(source, bytes) else self._put_file(source, move)
        except OSError as error:
            raise explain(error, self.folder if isinstance(source, bytes) else source) from error

    def get(self, sha: str) -> Path:
        """The file of a blob, read-only.

        Raises:
            StoreError: it is not in this store.
        """
        path = self.path(sha)
        if not path.is_file():
            raise StoreError(
                f"blob {sha[:12]} is not in the store",
                where=path,
                mend="make it again: hardcase loop --resume; see what is damaged: hardcase doctor",
            )
        return path

    def verify(self, sha: str) -> Path:
        """The file of a blob after its bytes were read and hashed.

        Raises:
            StoreError: it is missing, or its bytes are not those that were stored.
        """
        path = self.get(sha)
        if (found := sha256_file(path)) != sha:
            raise StoreError(
                f"blob {sha[:12]} is damaged: its bytes hash to {found[:12]}",
                where=path,
                mend=f"delete it (rm -f {path}) and make it again: hardcase loop --resume",
            )
        return path

    def erase(self, sha: str) -> int:
        """Take a blob away for good; returns its size [B], 0 if it is not there."""
        path = self.path(sha)
        try:
            size = path.stat().st_size
            self._fault("erase blob")
            path.unlink()
        except FileNotFoundError:
            return 0
        return size

    def settle(self, shas: Iterable[str]) -> None:
        """Make the names of blobs durable, so that a row may mention them.

        Raises:
            StoreError: one of them is not in this store.
        """
        for sha in shas:
            self.get(sha)
        self._fault("fsync blob folder")  # one flat folder: one fsync, however many names are new
        sync_folder(self.folder)

    def _put_bytes(self, data: bytes) -> str:
        sha = sha256(data)
        self._refuse(sha)
        if not self._present(sha, len(data)):
            handle, name = mkstemp(dir=self._tmp)
            try:
                with os.fdopen(handle, "wb") as stream:
                    stream.write(data)
                    self._finish(stream)
                self._name(Path(name), sha)
            except BaseException:
                Path(name).unlink(missing_ok=True)
                raise
        return sha

    def _put_file(self, source: Path, move: bool) -> str:
        sha = sha256_file(source)
        try:
            self._refuse(sha)
        except StoreError:
            if move:
                source.unlink()
            raise
        if self._present(sha, source.stat().st_size):
            if move:
                source.unlink()
            return sha
        if move and not source.is_symlink():
            try:
                with source.open("rb") as stream:
                    self._finish(stream)
                self._name(source, sha)
                return sha
            except OSError as error:
                if error.errno != errno.EXDEV:
                    raise
        self._copy(source, sha)
        if move:
            source.unlink()
        return sha

    def _copy(self, source: Path, sha: str) -> None:
        handle, name = mkstemp(dir=self._tmp)
        try:
            digest = hashlib.sha256()
            with os.fdopen(handle, "wb") as target, source.open("rb") as stream:
                while block := stream.read(BLOCK):
                    digest.update(block)
                    target.write(block)
                self._finish(target)
            if digest.hexdigest() != sha:
                raise StoreError(
                    "the file changed while it was stored", where=source, mend="store it once it is finished"
                )
            self._name(Path(name), sha)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise

    def _finish(self, stream: IO[bytes]) -> None:
        stream.flush()
        os.fchmod(stream.fileno(), 0o444)
        self._fault("fsync blob")
        os.fsync(stream.fileno())

    def _name(self, file: Path, sha: str) -> None:
        self._fault("rename blob")
        file.replace(self.path(sha))

    def _present(self, sha: str, size: int) -> bool:
        """Whether the blob is whole by its size; a damaged one is written anew."""
        path = self.path(sha)
        try:
            if path.stat().st_size != size:
                return False
            os.utime(path)  # young again: gc leaves it alone until a row mentions it
        except FileNotFoundError:
            return False
        except PermissionError:
            pass  # another user's blob is as good, and gc of that user keeps its own time
        return True
